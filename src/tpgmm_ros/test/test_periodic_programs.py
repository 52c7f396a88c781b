# SPDX-License-Identifier: Apache-2.0
"""A movement that repeats, in bags: trained by what its task file says, evaluated, shown."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, Topic, write_bag
from tpgmm_core.retrieval.methods import load_model
from tpgmm_ros.programs import evaluate, show, train
from wiping import PERIOD, wiping_demonstrations

COUNT = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wiping")
    settings = "model: {n_components: 5, reg_covar: 1.0e-4, max_iter: 50}"
    (folder / "task.yaml").write_text(REACH_TASK.replace(settings, "model: {retrieval: periodic}"))
    for i, shown in enumerate(wiping_demonstrations(COUNT)):
        before = np.concatenate(
            [shown.frames["object"].b[1:4], shown.frames["object"].A[4:, 4:] @ [0.0, 0.0, 0.0, 1.0]]
        )
        topics = {
            "/endpoint/pose": Topic(shown.data[:, 1:], shown.times),
            "/object/pose": Topic(np.tile(before, (len(shown.times), 1)), shown.times),
        }
        write_bag(folder / "bags" / f"demo_{i}", topics)
    return folder


def test_wiping_is_trained_shown_and_known_where_it_was_left_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task, output = ["--task", str(folder / "task.yaml")], tmp_path / "wipe.tpgmm"
    arguments = ["--leave-one-out", "--report", str(tmp_path), "--output", str(output)]
    assert train.main([*task, *arguments, str(folder / "bags")]) == 0
    said, report = capsys.readouterr().out, json.loads((tmp_path / "report.json").read_text())
    assert f"the movement repeats: {report['cycles']} cycles were shown, of {report['period_s']:.2f} s" in said
    assert report["period_s"] == pytest.approx(PERIOD, rel=0.15)
    assert report["leave_one_out"]["mean"]["position_rmse_m"] < 0.01
    assert 0.7 < report["leave_one_out"]["calibration"]["scaled_coverage"]["0.9"] <= 1.0

    assert show.main(["--json", str(output)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["period_s"] == load_model(output).period_ and found["cycles"] == report["cycles"]  # type: ignore[attr-defined]
    assert show.main([str(output)]) == 0
    assert f"{report['period_s']:.2f} s, of {report['cycles']} cycles" in capsys.readouterr().out

    assert evaluate.main([*task, "--json", str(folder / "bags")]) == 0
    (row,) = json.loads(capsys.readouterr().out)["results"]
    assert row["name"] == "periodic"
    assert row["position_rmse_m"] == pytest.approx(report["leave_one_out"]["mean"]["position_rmse_m"])


def test_what_repeats_is_found_out_and_chosen_for(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The task file names no method, or another one."""
    (tmp_path / "task.yaml").write_text(REACH_TASK)
    arguments = ["--task", str(tmp_path / "task.yaml"), "--auto", "--trials", "2", "--workers", "1"]
    arguments += ["--output", str(tmp_path / "model"), "--report", str(tmp_path)]
    assert train.main([*arguments, str(folder / "bags")]) == 0
    said, report = capsys.readouterr().out, json.loads((tmp_path / "report.json").read_text())
    assert report["auto"]["best"]["method"] == "periodic" and report["auto"]["best"]["frames"] == ["object"]
    assert report["auto"]["best"]["error"]["position"] < 0.01 < report["auto"]["task_file"]["error"]["position"]
    assert "in each tenth of the cycle" in said and "the movement repeats" in said
    model = load_model(tmp_path / "model")
    assert model.period_ == pytest.approx(PERIOD, rel=0.15)  # type: ignore[attr-defined]
