# SPDX-License-Identifier: Apache-2.0
"""How the model's time advances: with the clock, with the length of the path, or with the robot.

A phase turns times of a loop (ns) into the model's times (s). All phases go faster, slower, back or not at all by
`speed`, which changes smoothly, and stop at both ends of the movement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.retrieval.interface import TimeParametrized
from tpgmm_core.retrieval.time_scaling import TimeScaling

_SECOND = 1_000_000_000
SPEED_TIME_CONSTANT = 0.1  # s, with which a new speed is taken over
MAX_SPEED = 10.0
ARC_SAMPLES = 64
STANDING_SHARE = 1e-3
PROBE = 0.005  # half the step, as a share of the duration, for the slope of the movement
MAX_DEVIATION = 0.1  # of an estimate of the model's time, as a share of its duration


class ClockPhase:
    """The model's time is that of the clock, scaled to the duration that is requested."""

    def __init__(self) -> None:
        self._time_scaling = TimeScaling(1.0, SPEED_TIME_CONSTANT)
        self.start(0)

    def bind(self, course: TimeParametrized, duration: float) -> None:
        """Use this movement from now on.

        Parameters
        ----------
        course
            the movement as a function of the model's time
        duration
            of the movement at speed 1, s
        """
        self._course, self._duration = course, duration
        self._model_duration = course.duration

    @property
    def duration(self) -> float:
        """Duration of the movement at speed 1, s."""
        return self._duration

    @property
    def speed(self) -> float:
        """Speed: 1 as learned, 0 pauses, less than 0 goes back.

        It may be set at any time, and changes through a low-pass with SPEED_TIME_CONSTANT.

        Raises
        ------
        ValueError
            for one that is not finite or beyond MAX_SPEED
        """
        return self._time_scaling.target

    @speed.setter
    def speed(self, speed: float) -> None:
        if not abs(speed) <= MAX_SPEED:
            raise ValueError(f"the speed is {speed!r}; give a number from {-MAX_SPEED:g} to {MAX_SPEED:g}")
        self._go_on_from(self._value)
        self._time_scaling.target = float(speed)

    def start(self, time_ns: int, value: float = 0.0) -> None:
        """Begin at this time, ns, at a share `value` of the movement, with the speed that is set."""
        self._origin_ns = self._last_ns = time_ns
        self._origin = self._value = min(max(value, 0.0), 1.0)
        self._time_scaling.rate = self._time_scaling.target

    def situated(self) -> None:
        """Be notified that the situation of the movement has changed."""

    def advance(self, time_ns: int) -> None:
        """Advance to this time, ns. A clock that steps back cannot get before the last change of speed."""
        self._last_ns = time_ns
        passed = float(self._passed(self._since_origin()))
        self._value = min(max(self._origin + passed / self._duration, 0.0), 1.0)

    def observe(self, reference: Gaussian, state: Array) -> None:
        """Be notified that the robot is at `state` (D,) while it should be at the reference."""

    @property
    def value(self) -> float:
        """Share of the movement that is done: 0 at its start, 1 at its end."""
        return self._value

    def times(self, ahead: Array) -> Array:
        """The model's times (H,), s, at times (H,) ahead of now, s."""
        values = self._origin + self._passed(self._since_origin() + ahead) * (1.0 / self._duration)
        return self._model_times(np.minimum(np.maximum(values, 0.0), 1.0))

    def _model_times(self, values: Array) -> Array:
        return values * self._model_duration

    def _since_origin(self) -> float:
        return max(0.0, (self._last_ns - self._origin_ns) / _SECOND)

    def _passed(self, seconds: float | Array) -> float | Array:
        """Scaled time, s, that passes within some seconds from the last change of speed on."""
        scaling = self._time_scaling
        return scaling.target * seconds if scaling.rate == scaling.target else scaling.ahead(seconds)

    def _go_on_from(self, value: float) -> None:
        """Make now, with this value, the origin. At an end of the movement, a speed that leads beyond it is 0."""
        scaling = self._time_scaling
        scaling.advance(self._since_origin())
        if (value >= 1.0 and scaling.rate > 0.0) or (value <= 0.0 and scaling.rate < 0.0):
            scaling.rate = 0.0
        self._origin_ns, self._origin, self._value = self._last_ns, value, value


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcLengthConfig(Settings):
    """How the length of a path is measured, and how fast it is travelled."""

    metres_per_radian: float = setting(0.25, 0.0, 10.0, "Length that a turn adds to a path, m/rad")
    path_speed: float = setting(0.0, 0.0, 10.0, "Speed along the path, m/s; 0: whatever fits the duration")
    easing: float = setting(0.1, 0.01, 0.5, "Share of the duration for speeding up, and for slowing down")


class ArcLengthPhase(ClockPhase):
    """The path is travelled at constant speed of arc length, whatever the timing of the demonstrations was.

    The length is that of the movement's means, coordinates of R^n in m, turns with `metres_per_radian`. It comes from
    ARC_SAMPLES points between which the model's time is a monotone cubic of the length; the value is the share of the
    duration, over which the speed is a trapezium. Where the movement stands still, and there is no length to go by, the
    model's time passes at 1 / STANDING_SHARE times its usual rate. When frames change, the model's time stays what it
    is.
    """

    def __init__(self, config: ArcLengthConfig | None = None) -> None:
        self.config = config or ArcLengthConfig()
        _ = scipy.interpolate, scipy.optimize  # loaded by their names, which takes a while: not during a movement
        self._path: scipy.interpolate.PchipInterpolator | None = None
        super().__init__()

    def bind(self, course: TimeParametrized, duration: float) -> None:
        """Use this movement from now on; its length is computed with the first situation."""
        super().bind(course, duration)
        self._path = None
        self._metric = np.ones(course.manifold.tangent_dim)
        for s in course.manifold.spheres:
            self._metric[s.tangent] = self.config.metres_per_radian

    def start(self, time_ns: int, value: float = 0.0) -> None:
        """Begin at this time, ns; the length is computed anew."""
        super().start(time_ns, value)
        self._path = None

    def situated(self) -> None:
        """Compute the length of the path in the new situation; the model's time stays."""
        now = None if self._path is None else float(self._model_times(np.array([self._value]))[0])
        times = np.linspace(0.0, self._model_duration, ARC_SAMPLES)
        means = self._course.at(times)[0]
        steps = np.linalg.norm(self._course.manifold.log(means[:-1], means[1:]) * self._metric, axis=1)
        length = float(steps.sum())
        standing = STANDING_SHARE * max(length, np.finfo(float).tiny) / len(steps)
        shares = np.concatenate([[0.0], np.cumsum(steps + standing)])
        path = self._path = scipy.interpolate.PchipInterpolator(shares / shares[-1], times)
        value = self._value
        if now is not None:
            value = self._value_of_share(share_at(path, now))
        if self.config.path_speed > 0.0 and length > 0.0:
            self._duration = length / (self.config.path_speed * (1.0 - self.config.easing))
        if now is not None:
            self._go_on_from(value)

    def _model_times(self, values: Array) -> Array:
        assert self._path is not None
        return np.asarray(self._path(self._shares_of(values)))

    def _shares_of(self, values: Array) -> Array:
        """Shares of the length: the integral of a trapezium over the values, 0 to 1."""
        r = self.config.easing
        nearer = np.minimum(values, 1.0 - values)
        half = np.where(nearer < r, nearer * nearer / (2.0 * r), nearer - 0.5 * r) / (1.0 - r)
        return np.where(values < 0.5, half, 1.0 - half)

    def _value_of_share(self, share: float) -> float:
        r = self.config.easing
        nearer = min(share, 1.0 - share) * (1.0 - r)
        half = math.sqrt(2.0 * r * nearer) if nearer < 0.5 * r else nearer + 0.5 * r
        return half if share < 0.5 else 1.0 - half


def share_at(path: scipy.interpolate.PchipInterpolator, time: float) -> float:
    """The share, 0 to 1, at which a path of increasing model's times over shares has a time."""
    if time <= path(0.0):
        return 0.0
    if time >= path(1.0):
        return 1.0
    return float(scipy.optimize.brentq(lambda share: float(path(share)) - time, 0.0, 1.0, xtol=1e-14))


@dataclass(frozen=True, slots=True, kw_only=True)
class StatePhaseConfig(Settings):
    """How the model's time follows the robot."""

    timing_noise: float = setting(0.1, 1e-4, 10.0, "Standard deviation that the model's time gains per second, s")
    memory: float = setting(0.1, 1e-3, 10.0, "Time within which deviations of the robot count as one observation, s")
    response: float = setting(0.05, 1e-3, 1.0, "Time constant with which observations take effect, s")
    catch_up: float = setting(2.0, 1.0, 10.0, "Largest correction, in multiples of the speed as learned")


class StatePhase(ClockPhase):
    """The model's time t is estimated from where the robot is: a scalar extended Kalman(-Bucy) filter.

    Process: t' = speed · T / duration + noise, `timing_noise`² = Q (s² per s), for a model of duration T. Measurement:
    the robot x ~ N(mu(t), Sigma(t)), the Gaussian of the movement, once per `memory`. With H = dmu/dt, the information
    in a second is h = H^T Sigma^-1 H / memory, the variance P follows P' = Q - P² h within (MAX_DEVIATION T)², and t is
    corrected by P H^T Sigma^-1 (x - mu) / memory per s. So the model's time waits for a robot that is held, ahead of it
    by as much as makes correction and speed cancel out; it catches up with a robot that is carried ahead; a push across
    the path, in the metric of Sigma, changes nothing; and where the movement stands still the clock decides.

    Corrections pass a low-pass of `response`, and P h is at most 1 / (4 `response`), which damps the loop critically;
    the velocity of the reference does not jump even if the robot's position does. They are at most `catch_up` times
    the speed as learned, and vanish with the speed: a pause is a pause.
    """

    def __init__(self, config: StatePhaseConfig | None = None) -> None:
        self.config = config or StatePhaseConfig()
        super().__init__()

    def start(self, time_ns: int, value: float = 0.0) -> None:
        """Begin at this time, ns, without a correction and certain of the value."""
        super().start(time_ns, value)
        self._correction = self._observed = 0.0  # of the value, per s: in effect, and last observed
        self._variance = self._unobserved = 0.0

    def advance(self, time_ns: int) -> None:
        """Advance to this time, ns, with the speed and the corrections that are in effect."""
        seconds = max(0.0, (time_ns - self._last_ns) / _SECOND)
        self._correction += -math.expm1(-seconds / self.config.response) * (self._observed - self._correction)
        value = self._value + self._time_scaling.ahead(seconds) / self._duration + self._effective(seconds)
        self._last_ns = time_ns
        self._go_on_from(min(max(float(value), 0.0), 1.0))
        self._unobserved += seconds
        self._observed = 0.0  # a robot that is no longer seen corrects nothing

    def observe(self, reference: Gaussian, state: Array) -> None:
        """Correct the model's time by where the robot is, `state` (D,), beside the reference."""
        seconds, self._unobserved = self._unobserved, 0.0
        config, T = self.config, self._model_duration
        at = T * np.clip(self._value + np.array([-PROBE, PROBE]), 0.0, 1.0)
        before, after = self._course.at(at)[0]
        manifold = reference.manifold
        slope = manifold.log(before, after) / (at[1] - at[0])
        weighted = np.linalg.solve(reference.covariance, slope) / config.memory
        information = float(slope @ weighted)
        variance = min(self._variance + config.timing_noise**2 * seconds, (MAX_DEVIATION * T) ** 2)
        self._variance = variance = variance / (1.0 + variance * information * seconds)
        gain = min(variance, 0.25 / (config.response * max(information, 1e-9)))
        largest = config.catch_up / self._duration
        correction = gain * float(weighted @ manifold.log(reference.mean, state)) / T
        self._observed = min(max(correction, -largest), largest)

    def times(self, ahead: Array) -> Array:
        """The model's times (H,), s, at times (H,) ahead of now, s, with the corrections that are in effect."""
        values = self._value + self._time_scaling.ahead(ahead) / self._duration + self._effective(ahead)
        return self._model_times(np.minimum(np.maximum(values, 0.0), 1.0))

    def _effective[T: (float, Array)](self, seconds: T) -> T:
        """Change of the value by the correction within some seconds."""
        return min(1.0, abs(self._time_scaling.rate)) * self._correction * seconds


PHASES: dict[str, type[ClockPhase]] = {"clock": ClockPhase, "arc_length": ArcLengthPhase, "state": StatePhase}
"""By name, for files and parameters."""
