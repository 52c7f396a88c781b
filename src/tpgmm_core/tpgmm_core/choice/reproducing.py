# SPDX-License-Identifier: Apache-2.0
"""A whole movement of a model in the situation of a demonstration, as a robot would do it that follows at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.derived_frames import DerivedFrames, with_frames
from tpgmm_core.retrieval.interface import Retrieval, TimeParametrized
from tpgmm_core.retrieval.methods import make_retrieval, method_named, method_of


def reproduce(model: LearnedMixture, situation: Demonstration, method: str | None = None, settle: float = 0.0) -> Array:
    """What a model does at the times and with the frames of a demonstration.

    A method that knows the movement as a function of time is asked for each time in the situation then; where the
    movement repeats, for the phase that the demonstration has at each time, since it says when, but not where. One that
    has a state of its own is stepped through the times by a robot that is at once where it is to be. As long as no
    frame is visible the movement stays where it starts.

    Parameters
    ----------
    model
        of [time, point] as any method encodes it
    situation
        [time, point], in the space that the model was learned in; the model's derived frames are made where it has not
        got them
    method
        in place of the model's own
    settle
        a movement with a state of its own need not be at its end at the last time: it goes on in the last situation for
        this share of the whole time, and then there are more than T points

    Returns
    -------
    Array
        points (T, D), such as poses
    """
    return reproduce_gaussians(model, situation, method, settle)[0]


def reproduce_gaussians(
    model: LearnedMixture, situation: Demonstration, method: str | None = None, settle: float = 0.0
) -> tuple[Array, Array]:
    """What a model does, as `reproduce`, and how exactly.

    Parameters
    ----------
    model, situation, method, settle
        as for `reproduce`

    Returns
    -------
    tuple[Array, Array]
        means (T, D), and covariances (T, n, n) in the tangent spaces at them, without any calibration; those of samples
        in which no frame was visible are not known: NaN
    """
    chosen = method_of(model) if method is None else method_named(method)
    chosen.check(model)
    seen = as_seen_by(model, situation)
    course = chosen.course(model)
    if course is not None:
        return _as_function_of_time(
            course, seen, model.phases(seen) if isinstance(model, PeriodicTPGMM) else seen.times
        )
    return _step_by_step(make_retrieval(model, chosen.name, horizon_steps=0, calibrated=False), seen, settle)


def as_seen_by(model: LearnedMixture, situation: Demonstration) -> Demonstration:
    """A demonstration with the frames of a model, derived ones included.

    Parameters
    ----------
    model
        with metadata
    situation
        [time, point], with the frames that others are derived from

    Returns
    -------
    Demonstration
        the same movement
    """
    derived = DerivedFrames.of_metadata(model.metadata_)
    missing = [name for name in derived.sources if name not in situation.frames]
    return with_frames(derived.only(missing).extended(situation), model.frame_names_)


def _as_function_of_time(course: TimeParametrized, situation: Demonstration, times: Array) -> tuple[Array, Array]:
    n, T = course.manifold.tangent_dim, len(situation.times)
    poses, covariances = np.tile(situation.data[0, 1:], (T, 1)), np.full((T, n, n), np.nan)
    for first, end, frames in spans(situation):
        if frames:
            course.situate(frames, poses[0])
            poses[first:end], covariances[first:end], _ = course.at(times[first:end])
    return poses, covariances


def _step_by_step(movement: Retrieval, situation: Demonstration, settle: float) -> tuple[Array, Array]:
    times, n = situation.times, movement.manifold.tangent_dim
    poses, covariances = np.tile(situation.data[0, 1:], (len(times), 1)), np.full((len(times), n, n), np.nan)
    pose, known = poses[0], None
    for first, end, frames in spans(situation):
        for i in range(first, end) if frames else ():
            if known is None:
                movement.start(round(1e9 * times[i]), pose)
            gaussian = movement.step(round(1e9 * times[i]), frames, pose).gaussian
            poses[i] = pose = gaussian.mean
            covariances[i] = gaussian.covariance
            known = frames
    if known is None or settle == 0.0:
        return poses, covariances
    more, wider = [], []
    step = float(times[-1] - times[-2])
    for time in np.arange(times[-1] + step, times[-1] + settle * (times[-1] - times[0]), step):
        gaussian = movement.step(round(1e9 * time), known, pose).gaussian
        pose = gaussian.mean
        more.append(pose)
        wider.append(gaussian.covariance)
    return np.vstack([poses, *more]), np.concatenate([covariances, np.array(wider).reshape(-1, n, n)])


def spans(situation: Demonstration) -> Iterator[tuple[int, int, dict[str, Frame]]]:
    """Runs of samples through which nothing changes.

    Parameters
    ----------
    situation
        frames may move, come and go

    Yields
    ------
    tuple[int, int, dict[str, Frame]]
        the first sample, the one after the last, and the visible frames
    """
    visible = {name: situation.is_visible(name) for name in situation.frames}
    T = len(situation.times)
    changes = np.zeros(T, dtype=bool)
    for name, frame in situation.frames.items():
        changes[1:] |= np.diff(visible[name])
        if frame.is_time_varying:
            changes[1:] |= (np.diff(frame.A, axis=0) != 0.0).any(axis=(1, 2)) | (np.diff(frame.b, axis=0) != 0.0).any(1)
    starts = [0, *np.flatnonzero(changes).tolist()]
    for first, end in zip(starts, [*starts[1:], T], strict=True):
        frames = {name: frame.at(first) for name, frame in situation.frames.items() if visible[name][first]}
        yield first, end, frames


def without_frames(demonstration: Demonstration) -> Demonstration:
    """The same, seen from the base alone: what a model without task parameters learns of it, and reproduces."""
    D = demonstration.data.shape[1]
    return Demonstration(demonstration.times, demonstration.data, {"base": Frame(np.eye(D), np.zeros(D))})
