# SPDX-License-Identifier: Apache-2.0
"""Leave-one-out: how well a model tells what was done in a situation that it has not seen."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.baselines import BASELINES, Learner
from tpgmm_core.choice.calibration import knows_time, squared_distances_of
from tpgmm_core.choice.novelty import novelty_of
from tpgmm_core.choice.reproducing import reproduce_gaussians
from tpgmm_core.common.side_by_side import side_by_side
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_ros.recordings.bags import Recording, align

_METRES_PER_RADIAN = 0.1
"""How far apart two situations are: a turn by 0.1 rad counts as a centimetre."""


@dataclass(frozen=True, slots=True)
class PathErrors:
    """How far a path is from the one that was shown, at the same phase. The sign of a quaternion is no error.

    Attributes
    ----------
    position_rmse_m
        root of the mean squared distance
    position_end_m
        distance at the last sample
    orientation_mean_deg
        mean angle
    orientation_end_deg
        angle at the last sample
    position_by_tenth_m
        mean distance in each tenth of the movement, (10,): where the errors lie
    """

    position_rmse_m: float
    position_end_m: float
    orientation_mean_deg: float
    orientation_end_deg: float
    position_by_tenth_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Fold:
    """One demonstration left out.

    Attributes
    ----------
    recording
        what was left out
    path
        (T, 7), the reproduction by a model of the others
    model
        its errors
    nearest
        errors of replaying the most similar of the others, as seen from the anchor; for comparison
    baselines
        errors of `tpgmm_core.choice.baselines`, by name; for comparison. Without those that could not be learned, or
        have no answer in this situation
    iterations
        number of EM iterations
    squared_distances
        of what was shown from the reproduction, in units of its covariances, at each sample, (T,)
    novelty
        contradiction and distance: see `tpgmm_core.retrieval.novelty`
    """

    recording: Recording
    path: Array
    model: PathErrors
    nearest: PathErrors
    baselines: dict[str, PathErrors]
    iterations: int
    squared_distances: Array
    novelty: tuple[float, float]


def cross_validate(
    recordings: Sequence[Recording],
    learn: Callable[[list[Demonstration]], LearnedMixture],
    anchor: str,
    baselines: Learner | None = None,
    jobs: int = 1,
) -> Iterator[Fold]:
    """Train on all recordings but one, reproduce in the situation of that one; each in turn.

    The frames are those of the recording left out, over time. Its duration is not used: both paths are
    compared at the same phase.

    Parameters
    ----------
    recordings
        at least two
    learn
        a model of demonstrations
    anchor
        frame from which the nearest demonstration is replayed
    baselines
        how these are learned; None: not at all
    jobs
        processes, see `side_by_side`

    Yields
    ------
    Fold
        errors of the recording that was left out
    """

    def fold(number: int) -> Fold:
        left_out, others = recordings[number], _without(recordings, number)
        demonstrations, duration = align(others)
        model = learn(demonstrations)
        found, situation = tried(model, left_out, duration), left_out.to_demonstration(duration)
        return Fold(
            left_out,
            found.path,
            found.errors,
            path_errors(replay_nearest(others, left_out, anchor), left_out.movement),
            {} if baselines is None else baseline_errors(demonstrations, situation, left_out, baselines),
            int(model.n_iter_),
            found.squared_distances,
            novelty_of(model, demonstrations, situation, POSE),
        )

    yield from side_by_side(fold, range(len(recordings)), jobs)


@dataclass(frozen=True, slots=True)
class Tried:
    """A model tried on a recording that it has not learned from.

    Attributes
    ----------
    recording
        the recording
    path
        (T, 7), what the model does in its situation
    errors
        of that
    squared_distances
        as of `Fold`
    """

    recording: Recording
    path: Array
    errors: PathErrors
    squared_distances: Array


def tried(model: LearnedMixture, recording: Recording, duration: float) -> Tried:
    """Reproduce a recording by a model, whose movements take a duration, s.

    Parameters
    ----------
    model
        a fitted model
    recording
        that it has not learned from
    duration
        of its demonstrations, s

    Returns
    -------
    Tried
        what came of it
    """
    path, covariances = reproduce_gaussians(model, recording.to_demonstration(duration))
    distances = squared_distances_of(path, covariances, recording.movement, POSE, knows_time(model))
    return Tried(recording, path, path_errors(path, recording.movement), distances)


def tried_by_others(
    recordings: Sequence[Recording], learn: Callable[[list[Demonstration]], LearnedMixture], jobs: int = 1
) -> Iterator[Tried]:
    """Reproduce each recording by a model of the others.

    Parameters
    ----------
    recordings
        at least two
    learn
        a model of demonstrations
    jobs
        processes, see `side_by_side`

    Yields
    ------
    Tried
        what came of it

    Raises
    ------
    ValueError
        fewer than two recordings.
    """

    def trial(number: int) -> Tried:
        demonstrations, duration = align(_without(recordings, number))
        return tried(learn(demonstrations), recordings[number], duration)

    yield from side_by_side(trial, range(len(recordings)), jobs)


def _without(recordings: Sequence[Recording], number: int) -> list[Recording]:
    """All but one."""
    if len(recordings) < 2:
        raise ValueError(f"leave-one-out needs at least two demonstrations, {len(recordings)} given: record more")
    return [*recordings[:number], *recordings[number + 1 :]]


def replay_nearest(others: Sequence[Recording], situation: Recording, anchor: str) -> Array:
    """The recording whose frames were most like those of a situation at the start, moved with a frame.

    Parameters
    ----------
    others
        recordings to choose from
    situation
        the recording that is to be met
    anchor
        the frame that the movement is moved with

    Returns
    -------
    Array
        poses (T, 7)
    """

    def distance(other: Recording) -> float:
        return sum(_distance(other.frames[name][0], pose[0]) for name, pose in situation.frames.items())

    other = min(others, key=distance)
    # The sample nearest in phase: dense recordings need no interpolation of poses.
    phase = situation.times / situation.duration * other.duration
    index = np.abs(other.times[:, None] - phase).argmin(axis=0)
    here, there, moved = situation.frames[anchor], other.frames[anchor][index], other.movement[index]
    return compose(compose(here, inverse(there)), moved)


def baseline_errors(
    demonstrations: Sequence[Demonstration], situation: Demonstration, left_out: Recording, learner: Learner
) -> dict[str, PathErrors]:
    """Errors of the baselines in the situation of a recording.

    Parameters
    ----------
    demonstrations
        of the others, over [time, pose]
    situation
        the recording as one of them
    left_out
        the recording
    learner
        how the baselines are learned

    Returns
    -------
    dict[str, PathErrors]
        by name; without those that could not be learned, or have no answer
    """
    found = {}
    for name, learn in BASELINES.items():
        try:
            found[name] = path_errors(learn(demonstrations, learner)(situation), left_out.movement)
        except ValueError:  # a singular covariance, or frames that contradict each other so much
            continue
    return found


def path_errors(path: Array, shown: Array) -> PathErrors:
    """Errors of a path (T, 7) against the one that was shown (T, 7)."""
    distances = np.linalg.norm(path[:, :3] - shown[:, :3], axis=1)
    angles = np.degrees(quaternion.angle_between(path[:, 3:], shown[:, 3:]))
    return PathErrors(
        position_rmse_m=float(np.sqrt(np.mean(distances**2))),
        position_end_m=float(distances[-1]),
        orientation_mean_deg=float(angles.mean()),
        orientation_end_deg=float(angles[-1]),
        position_by_tenth_m=tuple(float(part.mean()) for part in np.array_split(distances, 10)),
    )


def mean_errors(errors: Sequence[PathErrors]) -> PathErrors:
    """Mean of each error over several paths."""
    return PathErrors(
        position_rmse_m=float(np.mean([e.position_rmse_m for e in errors])),
        position_end_m=float(np.mean([e.position_end_m for e in errors])),
        orientation_mean_deg=float(np.mean([e.orientation_mean_deg for e in errors])),
        orientation_end_deg=float(np.mean([e.orientation_end_deg for e in errors])),
        position_by_tenth_m=tuple(np.mean([e.position_by_tenth_m for e in errors], axis=0).tolist()),
    )


def mean_baselines(folds: Sequence[Fold]) -> dict[str, tuple[PathErrors, int]]:
    """Mean errors of each baseline that had an answer, and for how many of the folds, by name."""
    found = {name: [fold.baselines[name] for fold in folds if name in fold.baselines] for name in BASELINES}
    return {name: (mean_errors(errors), len(errors)) for name, errors in found.items() if errors}


def _distance(p: Array, q: Array) -> float:
    return float(np.linalg.norm(p[:3] - q[:3]) + _METRES_PER_RADIAN * quaternion.angle_between(p[3:], q[3:]))
