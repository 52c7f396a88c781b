# SPDX-License-Identifier: Apache-2.0
"""References without jumps, although the movement that they come from is suddenly another one.

The *course* is the movement as the model has it in the present situation. The difference between the former course and
the present one is kept as an *offset* that dies out as a critically damped spring does, continuous in velocity. Courses
may move fast and differ for a moment only, for example when one component takes over from another a little later. Then
the difference of their velocities lasts no longer than that: it is the *swing*, which is kept apart. The ratio to the
former covariance dies out as well (`CovarianceFade`). Offset and ratio are as large as the change was, and further
changes add up: differences that are noise alone leave smoothed noise, and the reference follows its course in time.
Once all of it is gone, the reference is exactly the course.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.frame_buffer import manifold_origin
from tpgmm_core.retrieval.covariance_fade import CovarianceFade
from tpgmm_core.retrieval.spring import critically_damped, left_of_two

#: The velocity of a reference is taken from two moments this far apart, s. Short, so that a controller which takes it
#: from a horizon of such steps sees the velocity that is kept continuous here.
MOMENT = 0.005
SWING = 0.25
"""A swing leads less than this share of the distance between the courses, since its velocity held for a moment only."""
NEGLIGIBLE = 1e-13  # offsets (m, rad) that rounding hides


class Continuity:
    """What remains, at present, of the former course of a reference.

    Parameters
    ----------
    manifold
        of the references
    time_constant
        with which it dies out, s

    Attributes
    ----------
    moments
        (M,), s from now: the times at which `take_over` needs both courses
    """

    def __init__(self, manifold: Manifold, time_constant: float) -> None:
        self.manifold = manifold
        self.time_constant = time_constant
        self.moments: Array = np.array([0.0, MOMENT, time_constant / 8.0, time_constant / 3.0, time_constant])
        self._fade = CovarianceFade(manifold.tangent_dim, time_constant)
        self.forget()
        origin = manifold_origin(manifold)
        manifold.exp(origin, manifold.log(origin, origin))  # compiled, or loaded from the cache
        self._after(MOMENT)

    def forget(self) -> None:
        """Make the reference equal to the course from now on."""
        self._fade.forget()
        self._forget_offset()

    def _forget_offset(self) -> None:
        self._offset, self._rate, self._swing, self._swing_rate = np.zeros((4, self.manifold.tangent_dim))
        self._swing_time = self.time_constant
        self._is_gone = True

    def take_over(
        self,
        former: Sequence[Array],
        means: Sequence[Array],
        shown: Array,
        covariances: Array,
        former_covariances: Array | None = None,
    ) -> None:
        """Continue from the former course without a jump, in place and velocity.

        Parameters
        ----------
        former
            where the reference would have been, points (D,) at `moments`, or at the first two of them
        means
            where the present course is at the same times
        shown
            covariance (n, n) of the last reference
        covariances, former_covariances
            of the present and of the former course, (M, n, n) at `moments`. None: without the former ones, the
            difference dies out with `time_constant`
        """
        apart = [self.manifold.log(mean, one) for mean, one in zip(means, former, strict=True)]
        changes = [there - self._after(s) for s, there in zip(self.moments.tolist(), apart, strict=False)]
        # The offset takes the difference of places, the swing that of velocities.
        self._offset = apart[0] - self._swing
        self._swing_time = self._time_of_swing(changes)
        rate = 1.0 / self._swing_time
        ahead = apart[1] - critically_damped(self._offset, self._rate, 1.0 / self.time_constant, MOMENT)[0]
        self._swing_rate = (math.exp(rate * MOMENT) * ahead - self._swing) / MOMENT - rate * self._swing
        self._is_gone = False
        lasts = 1.0
        if former_covariances is not None:
            lasts = self._fade.lasting(former_covariances, covariances, self.moments)
        self._fade.take_over(shown, covariances[0], lasts)

    def _time_of_swing(self, changes: Sequence[Array]) -> float:
        """Time constant, s, with which the swing goes no farther than the courses are apart within `time_constant`.

        Parameters
        ----------
        changes
            (n,) each, by how much the courses are apart, at `moments`. A swing that is still there counts by its share
            of the velocity
        """
        change = (changes[1] - changes[0]) / MOMENT
        size = float(np.linalg.norm(change))
        going_on = float(np.linalg.norm(self._swing_rate) + np.linalg.norm(self._swing) / self._swing_time)
        if size + going_on == 0.0 or len(changes) == 2:
            return self.time_constant
        reach = SWING * max(abs(float(change @ (there - changes[0]))) for there in changes[1:])
        time = min(max(reach / max(size, np.finfo(float).tiny) ** 2, MOMENT), self.time_constant)
        return (size * time + going_on * self._swing_time) / (size + going_on)

    def advance(self, seconds: float) -> None:
        """Let this time pass, s."""
        if seconds > 0.0:
            self._fade.advance(seconds)
            if not self._is_gone:
                self._advance_offset(seconds)

    def _advance_offset(self, seconds: float) -> None:
        rates = 1.0 / self.time_constant, 1.0 / self._swing_time
        self._offset, self._rate = critically_damped(self._offset, self._rate, rates[0], seconds)
        self._swing, self._swing_rate = critically_damped(self._swing, self._swing_rate, rates[1], seconds)
        left = np.abs(self._offset).max() + np.abs(self._swing).max()
        left += self.time_constant * (np.abs(self._rate).max() + np.abs(self._swing_rate).max())
        if left < NEGLIGIBLE:
            self._forget_offset()

    def mean(self, mean: Array, ahead: float = 0.0) -> Array:
        """Mean (D,) of the reference where the course has `mean`; both a time `ahead`, s."""
        if self._is_gone:
            return mean
        return self.manifold.exp(mean, self._after(ahead))

    def covariance(self, covariance: Array, ahead: float = 0.0) -> Array:
        """Covariance (n, n) of the reference where the course has `covariance`; both a time `ahead`, s."""
        return self._fade.of(covariance, ahead)

    def gaussian(self, mean: Array, covariance: Array, ahead: float = 0.0) -> Gaussian:
        """The reference where the new course says something else.

        Parameters
        ----------
        mean, covariance
            what the course says, (D,) and (n, n)
        ahead
            of the present time, s

        Returns
        -------
        Gaussian
            with what remains of the difference to the former course
        """
        mean, covariance = np.array(self.mean(mean, ahead)), np.array(self.covariance(covariance, ahead))
        if math.isfinite(mean.sum() + covariance.sum()):
            return Gaussian._made(mean, covariance, self.manifold)
        return Gaussian(mean, covariance, self.manifold)  # says what is wrong

    def _after(self, seconds: float) -> Array:
        """Sum of offset and swing, (n,), after a time."""
        if seconds == 0.0:
            return self._offset + self._swing
        left = np.empty_like(self._offset)
        left_of_two(
            self._offset, self._rate, 1.0 / self.time_constant, self._swing, self._swing_rate, 1.0 / self._swing_time,
            seconds, left,
        )  # fmt: skip
        return left
