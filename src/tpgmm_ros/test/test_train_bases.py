# SPDX-License-Identifier: Apache-2.0
"""`train --bases`: a task that is learned with the synergies of another one, and what `show` says of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_core import LearnedMixture
from tpgmm_core.retrieval.methods import load_model
from tpgmm_ros.programs import show
from tpgmm_ros.programs.train import main

COUNT = 5


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Demonstrations, their task file, and models: with bases of its own, of a method over velocities, and plain."""
    directory = tmp_path_factory.mktemp("bags")
    (directory / "bags").mkdir()
    for i in range(COUNT):
        write_bag(directory / "bags" / f"demo_{i}", reach(i, samples=40))
    (directory / "plain.yaml").write_text(REACH_TASK)
    (directory / "semi_tied.yaml").write_text(with_model("covariance: semi_tied"))
    (directory / "mfa.yaml").write_text(with_model("covariance: mfa"))
    (directory / "short.yaml").write_text(short_task())
    assert train(directory, "semi_tied", "own.tpgmm", [0, 1, 2]) == 0
    assert train(directory, "semi_tied", "velocities.tpgmm", [0, 1, 2], "--retrieval", "trajectory") == 0
    assert train(directory, "plain", "plain.tpgmm", [0, 1, 2]) == 0
    assert train(directory, "short", "short.tpgmm", [0, 1, 2]) == 0
    return directory


def with_model(setting: str) -> str:
    found = REACH_TASK.replace("model: {", f"model: {{{setting}, ")
    assert found != REACH_TASK
    return found


def train(bags: Path, task: str, output: str, demonstrations: list[int], *options: str) -> int:
    given = [str(bags / text) if text.endswith(".tpgmm") else text for text in options]
    named = [str(bags / "bags" / f"demo_{i}") for i in demonstrations]
    return main(["--task", str(bags / f"{task}.yaml"), "--output", str(bags / output), *given, *named])


def transforms(model: LearnedMixture) -> dict[str, np.ndarray]:
    return {name: frame.arrays()["transform"] for name, frame in model.emissions_.frames.items()}


@pytest.mark.parametrize("task", ["plain", "semi_tied"])
def test_a_task_is_learned_with_the_bases_of_another_model(
    task: str, bags: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--bases", "own.tpgmm", "--components", "2")
    assert train(bags, task, "new.tpgmm", [3, 4], *options, "--leave-one-out", "--jobs", "2") == 0
    own, model = load_model(bags / "own.tpgmm"), load_model(bags / "new.tpgmm")
    assert model.emissions_.structure.fixed_bases and len(model.priors_) == 2 != len(own.priors_)
    for name, A in transforms(model).items():
        np.testing.assert_array_equal(A, transforms(own)[name])
    assert json.loads(str(model.metadata_["bases"])) == {"model": "own.tpgmm", "task": "reach", "demonstrations": 3}
    capsys.readouterr()
    assert show.main(["--json", str(bags / "new.tpgmm")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["bases"] == "those of own.tpgmm (task reach, 3 demonstrations), not learned"
    assert "bases" not in found["other_metadata"]
    assert show.main([str(bags / "new.tpgmm")]) == 0
    assert found["bases"] in capsys.readouterr().out
    assert show.main(["--json", str(bags / "own.tpgmm")]) == 0
    assert json.loads(capsys.readouterr().out)["bases"] is None


def test_the_bases_stay_when_learning_goes_on(bags: Path) -> None:
    assert train(bags, "plain", "first.tpgmm", [3, 4], "--online", "--bases", "own.tpgmm") == 0
    assert train(bags, "plain", "later.tpgmm", [0], "--update", "first.tpgmm") == 0
    model = load_model(bags / "later.tpgmm")
    for name, A in transforms(model).items():
        np.testing.assert_array_equal(A, transforms(load_model(bags / "own.tpgmm"))[name])
    assert json.loads(str(model.metadata_["bases"]))["model"] == "own.tpgmm"


def test_bases_of_unknown_origin_are_shown_as_given(bags: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train(bags, "plain", "new.tpgmm", [3, 4], "--bases", "own.tpgmm") == 0
    model = load_model(bags / "new.tpgmm")
    del model.metadata_["bases"]
    model.save(bags / "unknown.tpgmm")
    assert show.main([str(bags / "unknown.tpgmm")]) == 0
    assert "given, not learned" in capsys.readouterr().out
    model.metadata_["bases"] = "[1]"
    model.save(bags / "unknown.tpgmm")
    assert show.main([str(bags / "unknown.tpgmm")]) == 1
    error = capsys.readouterr().err
    assert "the model's metadata say bases = " in error and "expected a model by name" in error


@pytest.mark.parametrize(
    ("task", "options", "reason"),
    [
        ("plain", ("--bases", "plain.tpgmm"), "plain.tpgmm: the model given for its bases has full covariances"),
        ("plain", ("--bases", "none.tpgmm"), "No such file"),
        ("plain", ("--bases", "velocities.tpgmm"), "a basis is of the same numbers only"),
        ("plain", ("--bases", "short.tpgmm"), "short.tpgmm: there are no bases for robot; there are some for object"),
        ("mfa", ("--bases", "own.tpgmm"), "--bases needs covariance: semi_tied, the task file says mfa"),
        ("plain", ("--bases", "own.tpgmm", "--retrieval", "promp"), "promp learns a ProMPTPGMM"),
        ("plain", ("--bases", "own.tpgmm", "--auto"), "--auto chooses covariances by itself: leave out --bases"),
        ("plain", ("--bases", "own.tpgmm", "--update", "own.tpgmm"), "leave out --auto, --leave-one-out, --online"),
        ("plain", ("--bases", "own.tpgmm", "--one-by-one"), "needs all samples at once"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_words(
    task: str, options: tuple[str, ...], reason: str, bags: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert train(bags, task, "refused.tpgmm", [3, 4], *options) == 1
    assert reason in capsys.readouterr().err and not (bags / "refused.tpgmm").exists()


def short_task() -> str:
    """The task without the frame of the robot."""
    lines = with_model("covariance: semi_tied").splitlines(keepends=True)
    found = "".join(line for line in lines if not line.lstrip().startswith("robot:"))
    assert found.count("\n") == len(lines) - 1
    return found
