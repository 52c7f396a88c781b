# SPDX-License-Identifier: Apache-2.0
"""`MovingFrames`: kinematic frames at each step and over demonstrations; `ConfigurationProduct`: a model of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.kinematics.chains import Kinematics
from tpgmm_core.kinematics.frames import KinematicFrame, PreviousConfiguration
from tpgmm_core.kinematics.inverse import THRESHOLD
from tpgmm_core.kinematics.tasks import KinematicState, compile_kernels
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.demonstration import Demonstration

STEP = 0.02
"""Steps of joints in demonstrations are scaled to steps of this length, s."""
PERSISTENCE = 0.4
"""How long joints are assumed to keep a speed, s."""
SHORTEST_STEP = STEP**2 / PERSISTENCE
"""In this time, 1 ms, a walk that takes a new speed every 0.4 s spreads as far as it goes in a STEP; see
`ConfigurationProduct`. Its steps are no shorter."""


@dataclass(frozen=True, slots=True, eq=False)
class MovingFrames:
    """The candidate frames of a robot.

    The constructor compiles everything, so that no step waits for the compiler.

    Parameters
    ----------
    kinematics
        the robot; it keeps the last configuration, hence it must not be used by two threads at once
    candidates
        name → frame
    threshold
        singular values of Jacobians below it are damped, see `kinematics.inverse`

    Raises
    ------
    ValueError
        for no candidates, and a threshold that is not positive
    """

    kinematics: Kinematics
    candidates: Mapping[str, KinematicFrame]
    threshold: float = THRESHOLD

    def __post_init__(self) -> None:
        if not self.candidates:
            raise ValueError("there must be at least one candidate frame")
        if not (np.isfinite(self.threshold) and self.threshold > 0.0):
            raise ValueError(f"the threshold of the damping is a positive number, got {self.threshold!r}")
        compile_kernels()

    @property
    def objects(self) -> frozenset[str]:
        """Names of the objects that any of the frames needs, without points of the robot, which are always known."""
        return frozenset[str]().union(*map(self.objects_of, self.candidates))

    def objects_of(self, name: str) -> frozenset[str]:
        """Names of the objects that one of the frames needs."""
        return self.candidates[name].objects - set(self.kinematics.points)

    def at(self, q: ArrayLike, objects: Mapping[str, Frame] | None = None, stride: float = 1.0) -> dict[str, Frame]:
        """All frames about a configuration, with the objects as they are now.

        Parameters
        ----------
        q
            (n,), configuration of the step before, q_{t-1}
        objects
            name → Frame of a position or a pose. Frames whose objects are not known are left out
        stride
            how long the step is, in STEPs

        Returns
        -------
        dict[str, Frame]
            name → frame

        Raises
        ------
        ValueError
            for a configuration that does not fit the robot or is not finite, and when no frame is left
        """
        q = np.array(q, dtype=float)
        if q.shape != (self.kinematics.n_joints,) or not np.all(np.isfinite(q)):
            raise ValueError(f"a configuration has shape ({self.kinematics.n_joints},) and is finite, got {q}")
        objects = objects or {}
        moment = KinematicState(self.kinematics, q, objects, self.threshold, stride)
        there = objects.keys() | set(self.kinematics.points)
        frames = {name: f.at(moment) for name, f in self.candidates.items() if f.objects <= there}
        if not frames:
            raise ValueError(f"none of the objects that the frames need is known; known are {sorted(objects)}")
        return frames

    def demonstration(
        self,
        times: ArrayLike,
        configurations: ArrayLike,
        objects: Mapping[str, Frame] | None = None,
        *,
        with_time: bool = False,
    ) -> Demonstration:
        """What all frames saw of a movement: its data are configurations, its frames move with them.

        The frames of each sample are those about the sample before; of the first one, about itself.

        Parameters
        ----------
        times
            (T,), s
        configurations
            (T, n), rad
        objects
            name → Frame, constant or with T steps
        with_time
            whether time is the first dimension of data and frames

        Returns
        -------
        Demonstration
            over configurations, or over [time, configuration]

        Raises
        ------
        ValueError
            like `at` and `Demonstration`, for objects that are not known, and times that do not increase
        """
        data, times = np.asarray(configurations, dtype=float), np.asarray(times, dtype=float)
        objects = objects or {}
        if not self.objects <= objects.keys():
            raise ValueError(f"the frames need the objects {sorted(self.objects)}, given are {sorted(objects)}")
        since = np.diff(times)
        if len(times) != len(data) or len(times) < 2 or not np.all(since > 0.0):
            raise ValueError(
                f"a movement has two or more samples at increasing times; got {len(data)} configurations, times {times}"
            )
        strides = np.concatenate([since[:1], since]) / STEP
        steps: dict[str, list[Frame]] = {name: [] for name in self.candidates}
        for t in range(len(data)):
            now = {name: frame.at(t) for name, frame in objects.items()}
            for name, frame in self.at(data[max(t - 1, 0)], now, strides[t]).items():
                steps[name].append(frame)
        frames = {name: _stacked(sequence) for name, sequence in steps.items()}
        if with_time:
            data = np.column_stack([times, data])
            frames = {name: frame.with_time() for name, frame in frames.items()}
        return Demonstration(times, data, frames)


def _stacked(frames: Sequence[Frame]) -> Frame:
    """One frame with T steps, all of which have their own inverses."""
    inverses = [frame.inverse for frame in frames if frame.inverse is not None]
    return Frame(np.stack([frame.A for frame in frames]), np.stack([frame.b for frame in frames]), np.stack(inverses))


class ConfigurationProduct:
    """A model of kinematic frames, retrieved: their product at each step, in configuration space.

    What no frame constrains stays at the configuration of the step before. Its speed depends neither on the
    length of its steps, nor on how often demonstrations were sampled. `PreviousConfiguration` learns speeds, and a
    step of dt allows for PERSISTENCE dt times their variance, as a random walk does that takes a new speed every
    PERSISTENCE. With variances in proportion to dt, steps are implicit Euler steps of a flow towards the product of the
    other frames; in proportion to dt², short steps would lead nowhere, and with constant variances they would arrive at
    once.

    Parameters
    ----------
    model
        fitted to `MovingFrames.demonstration`s, over time as the first dimension or with one component
    frames
        at least the model's

    Attributes
    ----------
    activations
        (K,), weights of the components in the last step

    Raises
    ------
    ValueError
        for a model of other frames, and a timeless mixture, which does not say when which component is active
    """

    def __init__(self, model: LearnedMixture, frames: MovingFrames) -> None:
        n = frames.kinematics.n_joints
        missing = sorted(set(model.frame_names_) - set(frames.candidates))
        if missing:
            raise ValueError(
                f"the model has the frames {missing}, which are not among the candidates {sorted(frames.candidates)}"
            )
        self.over_time = model.manifold_.dim == n + 1
        if not self.over_time and len(model.priors_) > 1:
            raise ValueError(
                f"a model without time has one component to be retrieved, got {len(model.priors_)}: learn over time "
                "(demonstration(..., with_time=True)) to have several"
            )
        candidates = {name: frames.candidates[name] for name in model.frame_names_}
        self.frames = MovingFrames(frames.kinematics, candidates, frames.threshold)
        self._damping = [name for name, frame in candidates.items() if isinstance(frame, PreviousConfiguration)]
        self._adapter = Adapter(model)
        self.activations: Array = np.ones(1)

    def step(
        self,
        q: ArrayLike,
        objects: Mapping[str, Frame] | None = None,
        time: float | None = None,
        weights: Mapping[str, float] | None = None,
        dt: float = SHORTEST_STEP,
    ) -> Gaussian:
        """Where to be next (n,), and how much each direction matters, as a Gaussian.

        The covariance is that of a step of SHORTEST_STEP, whatever dt is, so that a controller's gains do not depend on
        the rate.

        Parameters
        ----------
        q
            (n,), configuration of the step before
        objects
            as they are now; a frame whose objects are not known contributes nothing
        time
            of a model over time, s
        weights
            how far each frame is trusted, 0 to 1
        dt
            length of the step, s

        Returns
        -------
        Gaussian
            over configurations

        Raises
        ------
        ValueError
            like `MovingFrames.at`, and for a time that is missing, or given to a model without time
        """
        if (time is None) == self.over_time:
            raise ValueError(f"the model is {'' if self.over_time else 'not '}over time, got time = {time!r}")
        frames, state = self._situation(q, objects, time)
        short = self._product(frames, state, time, weights)
        if dt <= SHORTEST_STEP or not self._damping:
            return short
        given, share = weights or {}, SHORTEST_STEP / dt
        less_damped = {**given, **{name: share * given.get(name, 1.0) for name in self._damping}}
        return Gaussian(self._product(frames, state, time, less_damped).mean, short.covariance)

    def _product(
        self, frames: Mapping[str, Frame], state: Array, time: float | None, weights: Mapping[str, float] | None
    ) -> Gaussian:
        if time is None:
            return self._adapter.adapt(frames, state, weights).component(0)
        means, covariances, self.activations = self._adapter.adapt_and_condition(frames, [time], weights, state)
        return Gaussian(means[0], 0.5 * (covariances[0] + covariances[0].T))

    def mixture(
        self,
        q: ArrayLike,
        objects: Mapping[str, Frame] | None = None,
        time: float | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> GaussianMixture:
        """All components in the situation of a step.

        Parameters
        ----------
        q, objects, time, weights
            as for `step`

        Returns
        -------
        GaussianMixture
            over configurations, time first where the model has it
        """
        frames, state = self._situation(q, objects, time)
        return self._adapter.adapt(frames, state, weights)

    def _situation(
        self, q: ArrayLike, objects: Mapping[str, Frame] | None, time: float | None
    ) -> tuple[dict[str, Frame], Array]:
        """Frames and the state of the step before, with time where the model is over time."""
        frames, state = self.frames.at(q, objects), np.asarray(q, dtype=float)
        if time is None:
            return frames, state
        return {name: frame.with_time() for name, frame in frames.items()}, np.concatenate([[time], state])
