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
from tpgmm_core.retrieval import kernels_continuity as kernels
from tpgmm_core.retrieval.covariance_fade import CovarianceFade

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
        self._left = np.zeros((4, manifold.tangent_dim))  # offset, its rate, swing, its rate
        self._layout = manifold.ambient_of_tangent, manifold.sphere_starts
        self.forget()
        here = np.tile(manifold_origin(manifold), (len(self.moments), 1))
        manifold.exp(here[0], manifold.log(here[0], here[0]))  # compiled, or loaded from the cache
        self.take_over(here, here, np.eye(manifold.tangent_dim), np.eye(manifold.tangent_dim)[None])
        self.means(here, self.moments)
        self.advance(MOMENT)
        self.forget()

    def forget(self) -> None:
        """Make the reference equal to the course from now on."""
        self._fade.forget()
        self._forget_offset()

    def _forget_offset(self) -> None:
        self._left[:] = 0.0
        self._swing_time = self.time_constant
        self._is_gone = True

    def take_over(
        self,
        former: Sequence[Array] | Array,
        means: Sequence[Array] | Array,
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
        self._swing_time = kernels.take_over(
            np.array(former, dtype=float, order="C"), np.array(means, dtype=float, order="C"), self.moments, MOMENT,
            SWING, self.time_constant, self._swing_time, *self._layout, self._left,
        )  # fmt: skip
        self._is_gone = False
        lasts = 1.0
        if former_covariances is not None:
            lasts = self._fade.lasting(former_covariances, covariances, self.moments)
        self._fade.take_over(shown, covariances[0], lasts)

    def advance(self, seconds: float) -> None:
        """Let this time pass, s."""
        if seconds > 0.0:
            self._fade.advance(seconds)
            if not self._is_gone:
                self._advance_offset(seconds)

    def _advance_offset(self, seconds: float) -> None:
        left = kernels.advance(self._left, self.time_constant, self._swing_time, float(seconds))
        if left < NEGLIGIBLE:
            self._forget_offset()

    def mean(self, mean: Array, ahead: float = 0.0) -> Array:
        """Mean (D,) of the reference where the course has `mean`; both a time `ahead`, s."""
        return mean if self._is_gone else self.means(mean[None], np.array([ahead], dtype=float))[0]

    def means(self, means: Array, ahead: Array) -> Array:
        """Means (H, D) of the reference where the course has `means`, both at times (H,) from now, s."""
        shown = np.array(means, dtype=float, order="C")
        if not self._is_gone:
            kernels.lead(shown, self._left, self.time_constant, self._swing_time, ahead, *self._layout)
        return shown

    def covariance(self, covariance: Array, ahead: float = 0.0) -> Array:
        """Covariance (n, n) of the reference where the course has `covariance`; both a time `ahead`, s."""
        return self._fade.of(covariance, ahead)

    def gaussian(self, mean: Array, covariance: Array, ahead: float = 0.0) -> Gaussian:
        """The reference where the course has `mean` (D,) and `covariance` (n, n); both a time `ahead`, s."""
        return self.gaussians(mean[None], covariance[None], np.array([ahead], dtype=float))[0]

    def gaussians(self, means: Array, covariances: Array, ahead: Array) -> list[Gaussian]:
        """References where the new course says something else.

        Parameters
        ----------
        means, covariances
            what the course says, (H, D) and (H, n, n)
        ahead
            (H,), of the present time, s

        Returns
        -------
        list[Gaussian]
            H of them, with what remains of the difference to the former course
        """
        shown, result = self.means(means, ahead), []
        for i, seconds in enumerate(ahead.tolist()):
            mean, covariance = shown[i].copy(), np.array(self._fade.of(covariances[i], seconds))
            if math.isfinite(mean.sum() + covariance.sum()):
                result.append(Gaussian._made(mean, covariance, self.manifold))
            else:
                result.append(Gaussian(mean, covariance, self.manifold))  # says what is wrong
        return result
