# SPDX-License-Identifier: Apache-2.0
"""`recognize`: recordings are told apart by the skills of model files, and long ones are taken apart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, Topic, reach, write_bag
from tpgmm_ros.programs import recognize, train

ROOT = Path(__file__).resolve().parents[3]
VALVE = ROOT.parent / "shared" / "data" / "baxter_valve"


def back(seed: int, samples: int = 60) -> dict[str, Topic]:
    """From above the object to where the hand always starts."""
    topics = reach(seed, samples)
    hand = topics["/endpoint/pose"]
    return topics | {"/endpoint/pose": Topic(hand.poses[::-1], hand.recorded)}


def both(seed: int) -> dict[str, Topic]:
    """There and back."""
    there, again = reach(seed, 60), back(seed)
    times = np.concatenate([there["/endpoint/pose"].recorded, there["/endpoint/pose"].recorded + 5.1])
    poses = np.concatenate([there["/endpoint/pose"].poses, again["/endpoint/pose"].poses])
    return {
        "/endpoint/pose": Topic(poses, times),
        "/object/pose": Topic(np.tile(there["/object/pose"].poses[0], (120, 1)), times),
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A task file, a model of each of two skills, and bags that none of them has seen."""
    folder = tmp_path_factory.mktemp("skills")
    (folder / "task.yaml").write_text(REACH_TASK)
    for name, make in (("reach", lambda seed: reach(seed, 60)), ("back", back)):
        for seed in range(6):
            write_bag(folder / name / f"demo_{seed}", make(seed))
        arguments = ["--task", str(folder / "task.yaml"), "--leave-one-out", "--output", str(folder / f"{name}.tpgmm")]
        assert train.main([*arguments, str(folder / name)]) == 0
        for seed in (20, 21, 22):
            write_bag(folder / f"new_{name}" / f"new_{seed}", make(seed))
    write_bag(folder / "long", both(30))
    return folder


def run(folder: Path, *arguments: str) -> int:
    skills = [f"--skill={name}={folder / f'{name}.tpgmm'}" for name in ("reach", "back")]
    return recognize.main(["--task", str(folder / "task.yaml"), *skills, "--report", str(folder), *arguments])


@pytest.mark.parametrize(("name", "other"), [("reach", "back"), ("back", "reach")])
def test_recordings_that_were_not_seen_are_recognised(
    folder: Path, name: str, other: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(folder, "--expect", name, str(folder / f"new_{name}")) == 0
    out = capsys.readouterr().out
    assert f"expected: {name}, in 3 of 3" in out and f"0 × {other}" in out
    report = json.loads((folder / "report.json").read_text())
    assert report["passed"] and [item["found"] for item in report["recordings"]] == [name] * 3
    for item in report["recordings"]:
        assert item["probabilities"][-1][name] > 0.9
    assert run(folder, "--expect", other, str(folder / f"new_{name}")) == 1
    assert not json.loads((folder / "report.json").read_text())["passed"]


def test_models_are_found_in_the_home_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(folder))
    skills = [f"--skill={name}=~/{name}.tpgmm" for name in ("reach", "back")]
    assert recognize.main(["--task", "~/task.yaml", *skills, "--expect", "reach", "~/new_reach"]) == 0


def test_a_long_recording_is_taken_apart(folder: Path) -> None:
    assert run(folder, "--segments", str(folder / "long")) == 0
    found = json.loads((folder / "report.json").read_text())["segments"]
    assert [part["skill"] for part in found] == ["reach", "back"]
    assert found[0]["from_s"] == 0.0 and found[0]["to_s"] == found[1]["from_s"] == pytest.approx(5.0, abs=0.8)
    assert found[1]["to_s"] == pytest.approx(10.1, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--skill", "nothing"], "NAME=FILE"),
        (["--skill", "reach=nowhere.tpgmm"], "nowhere.tpgmm"),
        (["--expect", "dance"], "no such skill"),
        (["--skill", "third={model}=-1"], "above 0"),
    ],
)
def test_what_is_wrong_is_said(
    folder: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [text.format(model=folder / "reach.tpgmm") for text in arguments]
    assert run(folder, *given, str(folder / "new_reach")) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
