# SPDX-License-Identifier: Apache-2.0
"""`evaluate`: the errors of methods and of model files where they have not learned, the same as train finds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_ros.programs import evaluate, train


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluate")
    (folder / "task.yaml").write_text(REACH_TASK.replace("n_components: 5", "n_components: 2"))
    for i in range(6):
        write_bag(folder / ("new" if i > 3 else "bags") / f"demo_{i}", reach(i, samples=25))
    return folder


def run(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, Any], str]:
    status = evaluate.main(["--task", str(folder / "task.yaml"), "--json", *arguments])
    said = capsys.readouterr()
    return status, json.loads(said.out), said.err


def test_every_method_is_evaluated_by_default_and_the_best_comes_first(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, found, _ = run(folder, capsys, *(str(folder / "bags" / f"demo_{i}") for i in range(3)))
    assert status == 0 and [row["name"] for row in found["results"]] == list(METHODS)
    for row in found["results"]:
        assert len(row["demonstrations"]) == 3 and 0.0 < row["position_rmse_m"] < 0.2 and 0.0 <= row["coverage"] <= 1.0
    table = evaluate._table(found).splitlines()
    rmse = [float(line.split()[1]) for line in table[3:]]
    assert len(rmse) == len(METHODS) and rmse == sorted(rmse) and "each bag left out" in table[0]


def test_the_errors_are_those_that_train_finds_by_leave_one_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--task", str(folder / "task.yaml"), "--leave-one-out", "--report", str(tmp_path)]
    assert train.main([*arguments, "--retrieval", "time_steps", str(folder / "bags")]) == 0
    capsys.readouterr()
    report = json.loads((tmp_path / "report.json").read_text())["leave_one_out"]
    _, found, _ = run(folder, capsys, "--methods", "time_steps", "--", str(folder / "bags"))
    (row,) = found["results"]
    assert {key: row[key] for key in report["mean"]} == report["mean"]
    assert row["coverage"] == report["calibration"]["coverage"]["0.9"]


def test_held_out_bags_and_a_model_of_the_others_give_the_same_errors(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = str(tmp_path / "reach.tpgmm")
    assert train.main(["--task", str(folder / "task.yaml"), "--output", model, str(folder / "bags")]) == 0
    capsys.readouterr()
    new, old = str(folder / "new"), str(folder / "bags")
    status, found, _ = run(folder, capsys, "--methods", "adapt_regress", "--held-out", new, "--", old)
    assert status == 0 and found["on"] == "held-out bags"
    status, other, _ = run(folder, capsys, "--model", model, new)
    assert status == 0 and other["results"][0]["name"] == model
    (one,), (two,) = found["results"], other["results"]
    assert one["demonstrations"].keys() == two["demonstrations"].keys()
    assert one["position_rmse_m"] == pytest.approx(two["position_rmse_m"], rel=1e-9)


def test_what_cannot_be_evaluated_is_said_and_the_status_is_1(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.tpgmm").write_bytes(b"no model")
    status, found, _ = run(folder, capsys, "--model", str(tmp_path / "bad.tpgmm"), str(folder / "new"))
    assert status == 1 and "not a model file" in found["results"][0]["error"]
    assert "could not be evaluated" in evaluate._table(found)
    status, found, error = run(folder, capsys, "--model", "a", "--methods", "dmp", "--", str(folder / "new"))
    assert status == 1 and "leave out --held-out and --methods" in error == f"error: {found['error']}\n"
    status, found, error = run(folder, capsys, "--methods", "dmp", "--", str(folder / "new" / "demo_4"))
    assert status == 1 and "at least two demonstrations" in found["results"][0]["error"]


def test_bags_that_an_option_of_several_values_took_are_missed_with_the_reason(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, task = str(folder / "new"), ["--task", str(folder / "task.yaml")]
    for arguments, words in (
        (["--held-out", new, new], "no BAG is given: what stands behind --held-out belongs to it"),
        (["--methods", "dmp", new], "is no retrieval method; there are .* or -- before them"),
        ([], "no BAG is given$"),
    ):
        with pytest.raises(SystemExit) as ended:
            evaluate.main([*task, *arguments])
        assert ended.value.code == 2 and re.search(words, capsys.readouterr().err.strip(), re.DOTALL)


def test_a_model_on_what_it_has_learned_from_is_called_so(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = str(tmp_path / "reach.tpgmm")
    assert train.main(["--task", str(folder / "task.yaml"), "--output", model, str(folder / "bags")]) == 0
    capsys.readouterr()
    for bags, said in (("bags", "has learned from recordings with the names demo_0, demo_1"), ("new", "")):
        status, _, error = run(folder, capsys, "--model", model, str(folder / bags))
        assert status == 0 and (said in error) and bool(said) == ("warning" in error)


def test_processes_side_by_side_find_the_same_numbers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bit by bit: JSON holds all digits."""
    arguments = ["--methods", "adapt_regress", "--jobs"]
    one, two = (run(folder, capsys, *arguments, jobs, str(folder / "bags")) for jobs in ("1", "2"))
    assert one[0] == two[0] == 0 and one[1]["results"] == two[1]["results"]


def test_a_dask_cluster_finds_the_same_numbers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bit by bit, and each of its two workers has done a part."""
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install dask distributed")
    joblib = pytest.importorskip("joblib")
    arguments = ["--methods", "adapt_regress", "--jobs"]
    alone = run(folder, capsys, *arguments, "1", str(folder / "bags"))
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
        joblib.parallel_config("dask"),
    ):
        client.wait_for_workers(2)
        with distributed.get_task_stream(client) as tasks:
            found = run(folder, capsys, *arguments, "2", str(folder / "bags"))
    assert found[0] == alone[0] == 0 and found[1]["results"] == alone[1]["results"]
    assert len({task["worker"] for task in tasks.data}) == 2
