# SPDX-License-Identifier: Apache-2.0
"""What docs/reference/results.md says of generalisation holds: situations, shares of the way, the choice."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks import retrieval_table
from examples import extrapolation
from tpgmm_core import Demonstration
from tpgmm_core.choice.reproducing import reproduce, without_frames
from tpgmm_core.geometry import quaternion
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.recordings.bags import find_bags, read_recordings
from tpgmm_ros.task.task_file import Task

ROOT = Path(__file__).resolve().parents[1]
FRANKA = ROOT.parent / "shared" / "data" / "franka_bolts"


@pytest.fixture(scope="module")
def pick_place() -> retrieval_table.DataSet:
    task = Task.load(ROOT / "config" / "pick_place.yaml")
    recordings, bad = read_recordings(find_bags([ROOT / "bags" / "pick_place"]), task, every=20)
    assert not bad
    return retrieval_table.DataSet(recordings[:8], task, "target", with_orientation=True)


def in_plane(bend: float, samples: int = 50) -> NDArray[np.float64]:
    """Poses (samples, 7) along a bent line, turning by half a turn."""
    s = np.linspace(0.0, 1.0, samples)
    position = np.column_stack([s, bend * s * (1.0 - s), np.zeros(samples)])
    return np.hstack([position, quaternion.exp(np.outer(s, [0.0, 0.0, np.pi]))])


def test_shares_of_a_path_do_not_depend_on_its_pace() -> None:
    path = in_plane(0.5, 400)
    slow_first = path[np.round(399 * np.linspace(0.0, 1.0, 300) ** 2).astype(int)]
    waiting = np.vstack([slow_first, np.tile(slow_first[-1], (100, 1))])
    even, found = retrieval_table.at_shares(path), retrieval_table.at_shares(waiting)
    np.testing.assert_allclose(found[:, :3], even[:, :3], atol=0.01)
    assert np.degrees(quaternion.angle_between(found[:, 3:], even[:, 3:])).max() < 3.0
    steps = np.linalg.norm(np.diff(even[:, :3], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.02)


def test_the_demonstrated_range_once_is_what_was_demonstrated(pick_place: retrieval_table.DataSet) -> None:
    recordings = pick_place.recordings
    situations = extrapolation.pose_task(recordings, 2.0, "target", every=3)
    for i, new in zip((0, 3, 6), [new for new in situations if new.factor == 1.0], strict=True):
        demonstration = recordings[i].to_demonstration(2.0)
        for name, frame in demonstration.frames.items():
            A, seen = new.situation.frames[name].A, frame.at(-1)
            sign = np.sign(np.sum(A[4:, 4:] * seen.A[4:, 4:]))  # q and -q are one turn
            np.testing.assert_allclose(A[:4, :4], seen.A[:4, :4], atol=1e-9)
            np.testing.assert_allclose(sign * A[4:, 4:], seen.A[4:, 4:], atol=1e-9)
            np.testing.assert_allclose(new.situation.frames[name].b, seen.b, atol=1e-9)
        assert np.linalg.norm(new.end[:3] - recordings[i].movement[-1, :3]) < 0.01
    far = {new.factor: new.distance for new in situations[: len(extrapolation.FACTORS)]}
    assert far[4.0] == pytest.approx(4.0 * far[1.0])


@pytest.mark.parametrize("method", METHODS)
def test_every_method_ends_nearer_than_a_model_without_frames(method: str, pick_place: retrieval_table.DataSet) -> None:
    """At twice the demonstrated range."""
    recordings, settings = pick_place.recordings, {"n_components": 8, "reg_covar": 1e-5}
    demonstrations = [pick_place.demonstration(recording, 11.0) for recording in recordings]
    model = Recipe.of(settings, method).learn(demonstrations, pick_place.space)
    plain = Recipe.of(settings).learn([without_frames(d) for d in demonstrations], pick_place.space)
    for new in extrapolation.pose_task(recordings, 11.0, "target", every=4):
        if new.factor == 2.0:
            end = reproduce(model, new.situation, method, settle=1.0)[-1]
            other = reproduce(plain, without_frames(new.situation))[-1]
            assert np.linalg.norm(end[:3] - new.end[:3]) < 0.2 * np.linalg.norm(other[:3] - new.end[:3])


def test_the_model_is_chosen_without_what_is_left_out(pick_place: retrieval_table.DataSet) -> None:
    """Each candidate is learned, one of them is chosen, and errors are those of what was left out."""
    recordings = pick_place.recordings[:4]
    few = retrieval_table.DataSet(recordings, pick_place.task, "target", with_orientation=False)
    training = [few.demonstration(recording, 11.0) for recording in recordings[1:]]
    settings = {f"diag {K}": {"covariance": "diag", "n_components": K} for K in (3, 5)}
    found = list(retrieval_table.learned(settings, "adapt_regress", training, few.space))
    assert [name for name, _, _ in found] == list(settings) and sum(chosen for _, chosen, _ in found) == 1
    assert all(isinstance(d, Demonstration) and d.data.shape[1] == 4 for d in training)
    perfect = retrieval_table.errors(recordings[0].movement[:, :3], recordings[0])
    assert max(perfect.values()) == pytest.approx(0.0, abs=1e-6)
    shifted = retrieval_table.errors(recordings[0].movement + [0.3, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0], recordings[0])
    assert shifted["position_rmse_m"] == pytest.approx(0.5) and shifted["position_end_m"] == pytest.approx(0.5)
    assert shifted["position_rmse_by_share_m"] == pytest.approx(0.5)


@pytest.mark.skipif(not FRANKA.is_dir(), reason="the Franka recordings are not beside the repository")
def test_frames_are_worth_something_on_the_franka_recordings() -> None:
    data = dict(retrieval_table.data_sets(FRANKA.parent))["franka_bolts"]
    settings = {"covariance": "diag", "n_components": 5, "reg_covar": 1e-4}
    ends: dict[str, list[float]] = {"frames": [], "no frames": []}
    for left_out in data.recordings:
        training = [data.demonstration(other, 7.5) for other in data.recordings if other is not left_out]
        situation = data.demonstration(left_out, 7.5)
        model = Recipe.of(settings).learn(training, data.space)
        plain = Recipe.of(settings).learn([without_frames(d) for d in training], data.space)
        for name, path in (
            ("frames", reproduce(model, situation)),
            ("no frames", reproduce(plain, without_frames(situation))),
        ):
            ends[name].append(retrieval_table.errors(path, left_out)["position_end_m"])
    assert np.mean(ends["frames"]) < 0.1 * np.mean(ends["no frames"]) and np.mean(ends["frames"]) < 0.02
