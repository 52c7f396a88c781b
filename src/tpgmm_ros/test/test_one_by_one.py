# SPDX-License-Identifier: Apache-2.0
"""`train --one-by-one`: the model of the ordinary way, with one recording in the memory at a time."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_core import TPGMM
from tpgmm_ros.programs.train import main
from tpgmm_ros.recordings.one_by_one import OUTLINE, OneByOne, Parts
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task

SAMPLES = 150
"""More than an outline has."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("bags")
    for i in range(5):
        write_bag(directory / f"demo_{i}", reach(i, samples=SAMPLES))
    (directory / "task.yaml").write_text(REACH_TASK)
    return directory


def recording(number: int, samples: int) -> Recording:
    """A hand that goes to an object, without a bag."""
    rng = np.random.default_rng(number)
    times = np.linspace(0.0, 4.0, samples)
    place = np.append(rng.uniform(-0.3, 0.3, 3), [0.0, 0.0, 0.0, 1.0])
    movement = np.tile(place, (samples, 1))
    movement[:, :3] += (1.0 - times / 4.0)[:, None] * rng.uniform(0.2, 0.4, 3) + rng.normal(0.0, 0.001, (samples, 3))
    seen = np.arange(samples) > 3
    frames = {"object": np.tile(place, (samples, 1)), "robot": np.tile([0.0] * 6 + [1.0], (samples, 1))}
    joints = rng.normal(size=(samples, 2)) if number % 2 else None
    return Recording(Path(f"demo_{number}"), times, movement, frames, {"object": seen}, configurations=joints)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_the_model_is_that_of_all_recordings_at_once(bags: Path, tmp_path: Path, jobs: str) -> None:
    reports = []
    for name, more in (("whole", []), ("parted", ["--one-by-one", "--jobs", jobs])):
        given = ["--task", bags / "task.yaml", *more, "--output", tmp_path / name, "--report", tmp_path, bags]
        assert main([str(argument) for argument in given]) == 0
        reports.append(json.loads((tmp_path / "report.json").read_text()))
    for changing in ("model", "training_time_s", "log_likelihood"):
        for report in reports:
            report.pop(changing)
    assert reports[0] == reports[1] and reports[0]["samples"] == 5 * SAMPLES
    whole, parted = TPGMM.load(tmp_path / "whole"), TPGMM.load(tmp_path / "parted")
    assert whole.metadata_ == parted.metadata_
    for frame in ("object", "robot"):
        np.testing.assert_allclose(parted.means_[frame], whole.means_[frame], atol=1e-9)
        np.testing.assert_allclose(parted.covariances_[frame], whole.covariances_[frame], atol=1e-9)


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        (["--leave-one-out"], "leave out --leave-one-out"),
        (["--auto"], "leave out --auto"),
        (["--retrieval", "dmp"], "dmp learns a EndpointTPGMM, which needs all demonstrations at once"),
        (["--retrieval", "time_steps"], "needs all demonstrations at once"),
    ],
)
def test_what_needs_all_at_once_is_refused_before_anything_is_read(
    bags: Path, tmp_path: Path, more: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--task", str(bags / "task.yaml"), "--one-by-one", *more, "--output", str(tmp_path / "m"), "nothing_here"]
    assert main(given) == 1 and not (tmp_path / "m").exists()
    assert complaint in capsys.readouterr().err


def test_what_is_kept_comes_back_bit_by_bit_and_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with OneByOne(Task.from_text(REACH_TASK)) as kept:
        for number in (0, 1):
            given = recording(number, 3 * OUTLINE)
            outline = kept.keep(given)
            assert len(outline.times) == OUTLINE and outline.n_samples == 3 * OUTLINE
            found = kept.whole(outline)
            for name in ("times", "movement", "configurations"):
                assert np.array_equal(getattr(found, name), getattr(given, name))
            assert np.array_equal(found.visible["object"], given.visible["object"])
            assert all(np.array_equal(found.frames[name], given.frames[name]) for name in ("object", "robot"))
    assert not list(tmp_path.iterdir())


def test_memory_does_not_grow_with_the_recordings() -> None:
    peaks = []
    for count in (3, 12):
        with OneByOne(Task.from_text(REACH_TASK)) as kept:
            tracemalloc.start()
            parts = Parts(kept, [kept.keep(recording(2 * i, 5000)) for i in range(count)])
            TPGMM(2, manifold="R1 x R3 x S3", init="bins", max_iter=2).fit_parts(parts)
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]
