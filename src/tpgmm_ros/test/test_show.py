# SPDX-License-Identifier: Apache-2.0
"""`show`: what a model file of any kind says of itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.geometry import quaternion
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.programs import show, train

MANIFOLD = "R1 x R3 x S3"
DIMENSIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


def demonstrations(count: int = 5, samples: int = 25) -> list[Demonstration]:
    """Reaches: at first the hand is where the robot is, at the end above the object."""
    found = []
    for seed in range(count):
        topics = reach(seed, samples)
        hand, cup = topics["/endpoint/pose"], topics["/object/pose"].poses[0]
        frames = {
            "object": Frame.from_pose(cup[:3], cup[3:]).with_time(),
            "robot": Frame.from_pose(np.zeros(3), quaternion.IDENTITY).with_time(),
        }
        found.append(Demonstration(hand.recorded, np.column_stack([hand.recorded, hand.poses]), frames))
    return found


def shown(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert show.main(["--json", str(path)]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert show.main([str(path)]) == 0
    found["text"] = capsys.readouterr().out
    return found


@pytest.mark.parametrize("method", METHODS)
def test_a_model_of_every_kind_is_shown_and_the_frame_that_matters_changes_on_the_way(
    method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = Recipe.of({"n_components": 3, "reg_covar": 1e-5, "retrieval": method})
    recipe.learn(demonstrations(), MANIFOLD, DIMENSIONS).save(tmp_path / "model")
    found = shown(tmp_path / "model", capsys)
    assert found["kind"] == METHODS[method].estimator.__name__ and found["retrieval"] == method
    assert list(found["frames"]) == ["object", "robot"] and found["duration_s"] == pytest.approx(5.0)
    shares = {name: np.array(values) for name, values in found["relevance"]["shares"].items()}
    np.testing.assert_allclose(shares["object"] + shares["robot"], 1.0)
    if method == "dynamical_system":  # it has no time
        assert found["relevance"]["along"] == "component" and len(shares["object"]) == len(found["components"])
    else:
        assert shares["robot"][0] > 0.5 > shares["object"][0] and shares["object"][-1] > 0.5 > shares["robot"][-1]
    assert f"retrieval       {method}" in found["text"] and "█" in found["text"]
    assert "not calibrated" in found["text"] and "expected errors are not known" in found["text"]


def test_frames_that_count_in_each_segment_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recipe = Recipe.of({"n_components": 3, "reg_covar": 1e-5, "prune": 0.4})
    recipe.learn(demonstrations(), MANIFOLD, DIMENSIONS).save(tmp_path / "model")
    found = shown(tmp_path / "model", capsys)
    segments, order = found["segments"], np.argsort(found["segments"]["at"])
    assert segments["prune"] == 0.4 and not found["other_metadata"].keys() & {"prune", "prune.object", "prune.robot"}
    for name, first, last in (("robot", True, False), ("object", False, True)):
        assert [segments["kept"][name][k] for k in order[[0, -1]]] == [first, last]
    title, _, *rows = found["text"][found["text"].index("frames that count in each segment") :].splitlines()[:6]
    assert (
        "left out below 0.4" in title
        and "kept 1.00" in rows[-1]
        and rows[-1].index("kept") < rows[-1].index("left out")
    )


def test_what_a_model_was_learned_from_and_how_exact_it_is_stands_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "task.yaml").write_text(REACH_TASK)
    bags = [write_bag(tmp_path / f"demo_{i}", reach(i, samples=25)) for i in range(4)]
    arguments = ["--task", str(tmp_path / "task.yaml"), "--leave-one-out", "--output", str(tmp_path / "model")]
    arguments += ["--components", "2", "--report", str(tmp_path)]
    assert train.main([*arguments, *map(str, bags)]) == 0
    capsys.readouterr()
    report = json.loads((tmp_path / "report.json").read_text())["leave_one_out"]
    found = shown(tmp_path / "model", capsys)
    assert found["learned_from"] == ["demo_0", "demo_1", "demo_2", "demo_3"] and found["demonstrations"] == 4
    assert found["expected_errors"]["position_rmse_m"] == report["mean"]["position_rmse_m"]
    assert found["calibrated"] == {"adapt_regress": report["calibration"]["scale"]}
    assert len(found["novelty"]["distances"]) == 4
    assert "demo_0, demo_1" in found["text"] and f"{report['mean']['position_end_m']:.3f} m at the end" in found["text"]


def test_frames_of_joints_have_no_shares_and_it_is_said_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = TPGMM(1)
    flat = {"bar": Frame(np.eye(3), np.zeros(3)), "posture": Frame(np.eye(4), np.zeros(4))}
    random = np.random.default_rng(0)
    model.fit_projected({name: random.normal(size=(30, len(frame.b))) for name, frame in flat.items()})
    model.metadata_ = {"retrieval": "kinematic"}
    model.save(tmp_path / "model")
    found = shown(tmp_path / "model", capsys)
    assert "depends on the posture of the robot" in found["no_relevance_because"] and "relevance" not in found
    assert found["frames"] == {"bar": "of the task", "posture": "of the task"}


@pytest.mark.parametrize(("content", "words"), [(b"no model", "damaged, or not a model file"), (None, "No such file")])
def test_what_is_no_model_is_refused_in_one_line(
    content: bytes | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "model").write_bytes(content)
    assert show.main([str(tmp_path / "model")]) == 1
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert words in line and said.out == ""


def test_errors_in_the_metadata_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = Recipe.of({"n_components": 1}).learn(demonstrations(2, 12), MANIFOLD, DIMENSIONS)
    for key, value in (("expected_errors", "nonsense"), ("bags", '{"a": 1}'), ("expected_errors", '{"from": 3}')):
        model.metadata_[key] = value
        model.save(tmp_path / "model")
        assert show.main([str(tmp_path / "model")]) == 1
        assert f"metadata say {key}" in capsys.readouterr().err
        del model.metadata_[key]


def test_costs_are_written_for_a_model_over_time_and_refused_for_one_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for method in ("adapt_regress", "dynamical_system"):
        recipe = Recipe.of({"n_components": 3, "reg_covar": 1e-5, "retrieval": method})
        recipe.learn(demonstrations(), MANIFOLD, DIMENSIONS).save(tmp_path / method)
    assert show.main(["--costs", str(tmp_path / "costs.json"), str(tmp_path / "adapt_regress")]) == 0
    costs = json.loads((tmp_path / "costs.json").read_text())
    assert costs["dimensions"] == list(DIMENSIONS[1:]) and costs["times"][-1] == pytest.approx(costs["duration_s"])
    robot, cup = (np.array(costs["frames"][name]["precisions"]) for name in ("robot", "object"))
    assert robot.shape == (show.COST_TIMES, 6, 6)
    assert np.trace(robot[0, :3, :3]) > np.trace(cup[0, :3, :3]) and np.trace(cup[-1, :3, :3]) > np.trace(
        robot[-1, :3, :3]
    )
    capsys.readouterr()
    assert show.main(["--costs", str(tmp_path / "none.json"), str(tmp_path / "dynamical_system")]) == 1
    assert "need a model over time" in capsys.readouterr().err and not (tmp_path / "none.json").exists()
