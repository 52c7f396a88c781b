# SPDX-License-Identifier: Apache-2.0
"""`SemiMarkovMovement`: a movement from the states of a hidden semi-Markov model, and from where the robot is.

Durations say when each state is due (Yu 2010; Calinon et al., ICRA 2011), and the position of the robot says whether it
has come (`StateFilter`): the movement waits for a robot that is held, and catches up with one that is carried ahead.
The reference tracks what the states expect from there on (`Planner`). It continues from its own position and velocity,
whatever states and frames do: both are continuous.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.hidden_markov.markov import SemiMarkovChain
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.frame_buffer import manifold_origin
from tpgmm_core.model.reference import Reference
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval.dynamic_features import point_manifold, standing_frames
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.own_end import end_of
from tpgmm_core.retrieval.path_follower import AdaptedStates, PathFollower
from tpgmm_core.retrieval.state_filter import NominalSchedule, StateFilter

_SECOND = 1e-9


class SemiMarkovMovement:
    """A `Retrieval` (see `retrieval.interface`) by the states and durations of a `TPHSMM`.

    The path does not depend on the speed: all but `blend_time` is counted in samples of the demonstrations. Paused,
    the reference stays where it is, also when frames move. The speed is not negative: durations say how a state goes
    on, not how it came about.

    Parameters
    ----------
    model
        fitted to [time, position or pose], or with `derivatives` to [time, position or pose, velocity, acceleration];
        of these, derivatives say only which state a demonstration was in. Its metadata hold "duration_s". No state
        comes back ("left-right").
    duration
        of the whole movement, s; as demonstrated where None
    derivatives
        whether the model's data hold them
    horizon_steps, horizon_time_step
        of the references, s
    position_tolerance, orientation_tolerance
        standard deviations of the robot about its reference while nothing disturbs it, in units of the data and rad. A
        robot that is as near as usual to the reference that it was given follows, whatever states expect there. They
        are added to what a state knows, too.
    smoothing
        time constant with which the reference tracks a state, as a share of a state's mean duration
    blend_time
        time constant with which a change of speed is taken over, s

    Raises
    ------
    ValueError
        for a model that does not suit, and for numbers out of range
    """

    def __init__(
        self,
        model: TPHSMM,
        *,
        duration: float | None = None,
        derivatives: bool = False,
        horizon_steps: int = 2,
        horizon_time_step: float = 0.005,
        position_tolerance: float = 0.02,
        orientation_tolerance: float = 0.1,
        smoothing: float = 0.3,
        blend_time: float = 0.15,
    ) -> None:
        chain = getattr(model, "chain_", None)
        if not isinstance(chain, SemiMarkovChain):
            raise ValueError(f"a movement by states and durations needs a fitted TPHSMM, got {type(model).__name__}")
        factors = model.manifold_.factors
        if factors[0][0] != "R" or model.manifold_.tangent_dim < 2:
            raise ValueError(f"the first dimension of the model is time, then others; got {model.manifold_}")
        model_duration = demonstrated_duration(model)
        self._duration = model_duration if duration is None else duration
        numbers = {
            "duration": self._duration, "horizon_time_step": horizon_time_step, "smoothing": smoothing,
            "position_tolerance": position_tolerance, "orientation_tolerance": orientation_tolerance,
            "blend_time": blend_time,
        }  # fmt: skip
        for name, value in numbers.items():
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is a positive number, got {value!r}")
        self.model = model
        space = model.manifold_
        self._manifold = point_manifold(space) if derivatives else space.subset(range(1, space.dim))
        self._derivatives = derivatives
        self._tolerance = np.full(self._manifold.tangent_dim, orientation_tolerance)
        self._tolerance[self._manifold.flat_tangent] = position_tolerance
        self._schedule = NominalSchedule(chain)
        self._filter = StateFilter(chain, self._schedule)
        self._follower = PathFollower(self._schedule, self._manifold, smoothing)
        self._sample_time = model_duration / self._schedule.total
        self._ahead = horizon_time_step * np.arange(1, 1 + horizon_steps)
        self._horizon_time_step = horizon_time_step if horizon_steps else 0.0
        self._adapter = Adapter(model)
        end = end_of(model, self._manifold)
        self._end = None if end is None else Adapter(end)
        self._blend_time = blend_time
        self._speed = 1.0
        self._started = False
        self._compile()

    @property
    def manifold(self) -> Manifold:
        """Manifold of the references: the data's, without time and derivatives."""
        return self._manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""
        return self._adapter.frame_names

    @property
    def duration(self) -> float:
        """Duration of the whole movement at speed 1, undisturbed, s."""
        return self._duration

    @property
    def speed(self) -> float:
        """Speed: 1 as learned, 0 pauses.

        Raises
        ------
        ValueError
            when it is negative or not finite
        """
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        if not (math.isfinite(speed) and speed >= 0.0):
            raise ValueError(
                f"the speed is {speed!r}; this retrieval method cannot move backwards: give 0 or more, or choose a "
                "method that is a function of time"
            )
        self._speed = float(speed)

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin at a time: see `Retrieval.start`.

        Parameters
        ----------
        time_ns
            now, ns
        state
            where the robot is, where it is known
        phase
            where to begin, 0 to 1

        Raises
        ------
        ValueError
            for another phase
        """
        if not 0.0 <= phase <= 1.0:
            raise ValueError(f"the phase is 0 to 1, got {phase!r}")
        self._started, self._last_ns = True, time_ns
        self._begin_state = None if state is None else self._checked(state)
        self._begin_place = self._schedule.onwards(self._schedule.first, 0.0, phase * self._schedule.total)
        self._filter.reset(*self._begin_place)
        self._situation: Situation | None = None
        self._rate = self._speed
        self._remaining = self._schedule.remaining(*self._begin_place)
        self._is_seen = False

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time: see `Retrieval.step`. Without state, the movement follows the clock.

        Parameters
        ----------
        time_ns
            now, ns
        frames
            over [time, data], by name
        state
            where the robot is, where it is known
        weights
            how far each frame is trusted, 0 to 1

        Returns
        -------
        Reference
            over the data, without time

        Raises
        ------
        ValueError
            before `start`
        """
        if not self._started:
            raise ValueError("the movement has not been started: call start(time_ns)")
        state = None if state is None else self._checked(state)
        since = max(0.0, (time_ns - self._last_ns) * _SECOND)
        self._last_ns = time_ns
        if self._situation is not None:
            # the robot could only follow the reference that it was given, not the next one
            given = self._follower.at()
            samples = min(self._samples(since), self._schedule.total)  # after so long a gap the movement is over anyway
            self._rate = self._rate_after(since)
            self._advance(samples, state, given)
        situation = Situation(frames, weights, state)
        if self._situation is None or not situation.has_frames_of(self._situation):
            self._adopt(situation)
        follower = self._follower
        gaussian = Gaussian(follower.at(), follower.covariance, self._manifold)
        horizon = [
            Gaussian(follower.at(self._samples(ahead)), follower.covariance, self._manifold) for ahead in self._ahead
        ]
        if self._is_seen:
            activations = self._filter.probabilities
        else:
            activations = np.eye(len(self._schedule.nominal))[follower.place[0]]
        done = 1.0 - self._remaining / self._schedule.total
        return Reference(
            phase=1.0 if self._remaining < 0.5 else max(done, 0.0),  # less than half a sample is nothing
            gaussian=gaussian,
            horizon_time_step=self._horizon_time_step,
            horizon=tuple(horizon),
            activations=activations,
            frames=tuple(frames),
        )

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart, if the frames stay and the robot follows: see `Retrieval.horizon`."""
        self._check_stepped()
        follower = copy.copy(self._follower)
        result, before = [], 0.0
        for i in range(1, n + 1):
            samples = self._samples(i * dt)
            self._follow(follower, samples - before)
            before = samples
            result.append(Gaussian(follower.at(), follower.covariance, self._manifold))
        return result

    def mixture(self) -> GaussianMixture:
        """The states in the situation of the last step, over all dimensions that the model encodes."""
        self._check_stepped()
        return self._mixture

    def _adopt(self, situation: Situation) -> None:
        """Change to a situation; what no frame constrains stays where the robot, or else the reference, is."""
        frames, weights, where = situation.frames, situation.weights, situation.state
        if where is None:
            where = self._begin_state if self._situation is None else self._follower.at()
        full = None
        if where is not None:
            size = self.model.manifold_.dim
            full = np.concatenate([[0.0], where, np.zeros(size - 1 - len(where))])
        known = standing_frames(frames, self._manifold) if self._derivatives else frames
        self._mixture = self._adapter.adapt(known, full, weights)
        if self._mixture.manifold is not self.model.manifold_ and self._mixture.manifold != self.model.manifold_:
            raise ValueError(f"the frames map to {self._mixture.manifold}, the model is on {self.model.manifold_}")
        states = AdaptedStates.of(self._mixture, self._manifold, self._sample_time, self._tolerance)
        if self._end is not None:
            D = 1 + self._manifold.dim
            end = self._end.adapt(frames, None if full is None else full[:D], weights)
            states = states.ending(end.means[0, 1:], self._schedule.nominal[-1] - 1.0)
        if self._situation is None:
            self._follower.begin(self._begin_place, states, where)
        else:
            self._follower.change(states)
        self._situation = situation

    def _advance(self, samples: float, state: Array | None, given: Array) -> None:
        """Advance; at each whole sample, estimate the state from the robot's position.

        `given` (D,) is the reference that the robot was given.
        """
        follower = self._follower
        while samples > 0.0:
            part = min(samples, 1.0 - follower.fraction)
            samples -= part
            if not follower.advance(part):
                continue
            self._is_seen = state is not None
            self._filter.update(None if state is None else follower.states.fit(state, given))
            if state is None:
                place = self._schedule.onwards(*follower.place, 1.0)
                self._remaining = self._schedule.remaining(*place)
            else:
                place = self._filter.place
                self._remaining = self._filter.remaining
            follower.arrive(place)

    def _follow(self, follower: PathFollower, samples: float) -> None:
        """Advance without estimating the state."""
        while samples > 0.0:
            part = min(samples, 1.0 - follower.fraction)
            samples -= part
            if follower.advance(part):
                follower.arrive(self._schedule.onwards(*follower.place, 1.0))

    def _samples(self, seconds: float) -> float:
        """Number of samples by which the movement advances within a time, while the rate approaches the speed."""
        lag = self._blend_time * (1.0 - math.exp(-seconds / self._blend_time))
        return (self._speed * seconds + (self._rate - self._speed) * lag) * self._schedule.total / self._duration

    def _rate_after(self, seconds: float) -> float:
        return self._speed + (self._rate - self._speed) * math.exp(-seconds / self._blend_time)

    def _checked(self, state: Array) -> Array:
        state = np.array(state, dtype=float)
        if state.shape != (self._manifold.dim,) or not np.all(np.isfinite(state)):
            raise ValueError(f"the state is a point of {self._manifold}, ({self._manifold.dim},), got {state!r}")
        return state

    def _check_stepped(self) -> None:
        if not self._started or self._situation is None:
            raise ValueError("there was no step yet: call start(time_ns) and step(...)")

    def _compile(self) -> None:
        """Make two steps, so that no later one waits for the compiler; with one frame, which nothing contradicts."""
        name, view = next(iter(self.model.frame_manifolds_.items()))
        size = 1 + point_manifold(view).dim if self._derivatives else view.dim
        D = 1 + self._manifold.dim
        frame = Frame(np.eye(D, size), np.zeros(D))
        self.start(0)
        for i in range(2):
            time_ns = round(2 * i * self._duration / self._schedule.total / _SECOND)
            self.step(time_ns, {name: frame}, manifold_origin(self._manifold))
        self._started = False
