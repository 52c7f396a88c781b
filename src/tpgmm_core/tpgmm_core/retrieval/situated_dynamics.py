# SPDX-License-Identifier: Apache-2.0
"""What a model over [x, v] becomes in one situation: a goal, and what its velocities are regressed from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.endpoints import END, EndpointTPGMM
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval import kernels_dynamical_system as kernels
from tpgmm_core.retrieval.convergence import Convergence
from tpgmm_core.retrieval.covariance_mean import CovarianceMean
from tpgmm_core.retrieval.frame_derivatives import frames_with_derivatives


class SituatedDynamics:
    """A model in the situation that it was last shown.

    Parameters
    ----------
    model
        over [x, v]
    points
        manifold of x
    convergence
        how a movement comes to its goal
    duration
        of the demonstrations, s

    Attributes
    ----------
    metric
        (n,), squared weights of the dimensions in distances, m²/rad² on S³
    activations, regressed
        (K,) and (n,), which kernels write
    goal, mixture
        where the movement ends, and the adapted mixture over [x, v]
    covariances
        of positions, with weights and at points that are asked for
    law
        of `kernels_dynamical_system.stable_velocity`
    system
        what its kernels take, from the goal on
    """

    goal: Gaussian
    mixture: GaussianMixture
    law: Array
    system: tuple[Any, ...]

    def __init__(self, model: EndpointTPGMM, points: Manifold, convergence: Convergence, duration: float) -> None:
        n, K = points.tangent_dim, len(model.priors_)
        self._points, self._convergence, self._duration = points, convergence, duration
        self.metric = np.ones(n)
        for s in points.spheres:
            self.metric[s.tangent] = convergence.metres_per_radian**2
        self._adapter, self._endpoints = Adapter(model), Adapter(model.endpoints_)
        self._log_priors = np.log(np.maximum(model.priors_, np.finfo(float).tiny))
        self._prepared = np.empty((K, n, n)), np.empty(K), np.empty((K, n, n))
        self.activations, self.regressed = np.empty(K), np.zeros(n)
        self.covariances = CovarianceMean(points, K)

    def end(
        self, frames: Mapping[str, Frame], weights: Mapping[str, float] | None, state: Array | None, which: int
    ) -> Gaussian:
        """Where movements begin or end.

        Parameters
        ----------
        frames, weights
            over [time, x], by name, and how far each is trusted
        state
            (D,), where what no frame constrains stays; None: not known
        which
            BEGIN or END

        Returns
        -------
        Gaussian
            the product of the frames' Gaussians
        """
        return self._end(self._with_derivatives(frames), weights, state, which)

    def _end(
        self,
        frames_with_derivatives: Mapping[str, Frame],
        weights: Mapping[str, float] | None,
        state: Array | None,
        which: int,
    ) -> Gaussian:
        endpoints = self._endpoints.adapt(frames_with_derivatives, self._with_rest(state), weights)
        D, n = self._points.dim, self._points.tangent_dim
        return Gaussian(endpoints.means[which, :D], endpoints.covariances[which, :n, :n], self._points)

    def _with_derivatives(self, frames: Mapping[str, Frame]) -> dict[str, Frame]:
        return frames_with_derivatives(frames, self._points, 1, keeps_time=False)

    def _with_rest(self, state: Array | None) -> Array | None:
        return None if state is None else np.concatenate([state, np.zeros(self._points.tangent_dim)])

    def take(self, situation: Situation, x: Array) -> None:
        """Prepare the mixture and the goal of a situation for regression.

        Parameters
        ----------
        situation
            frames over [time, x]
        x
            (D,), where the system is: what no frame constrains stays there

        Raises
        ------
        ValueError
            like `Adapter.adapt`, and for covariances that are not positive definite
        """
        frames_with_derivatives, weights = self._with_derivatives(situation.frames), situation.weights
        self.mixture = self._adapter.adapt(frames_with_derivatives, self._with_rest(x), weights)
        self.goal = self._end(frames_with_derivatives, weights, x, END)
        centres, spreads = np.ascontiguousarray(self.mixture.means), np.ascontiguousarray(self.mixture.covariances)
        if not (
            kernels.prepare(self._log_priors, centres, spreads, self._points.dim, *self._prepared)
            and self.covariances.take(centres, spreads, self.goal)
        ):
            raise ValueError("a covariance of the adapted mixture is not positive definite")
        n = self._points.tangent_dim
        scale, T = self._convergence, self._duration
        means, variances = centres[:, -n:], np.diagonal(spreads, axis1=1, axis2=2)[:, -n:]
        speeds = np.sqrt(means**2 @ self.metric) + 2.0 * np.sqrt(variances @ self.metric)
        size = math.sqrt(float(np.diagonal(self.goal.covariance) @ self.metric))  # standard deviation of the length, m
        self.law = np.array([scale.rate / T, scale.goal_rate / T, 0.0, speeds.max(), scale.detour, size])
        self.system = (
            self.goal.mean.copy(), self.law, self.metric, centres, *self._prepared, self._points.ambient_of_tangent,
            self._points.sphere_starts, self.activations, self.regressed,
        )  # fmt: skip


def points_of(manifold: Manifold) -> Manifold:
    """The space of x.

    Parameters
    ----------
    manifold
        of [x, v]

    Returns
    -------
    Manifold
        of x

    Raises
    ------
    ValueError
        where there is none
    """
    n, odd = divmod(manifold.tangent_dim, 2)
    D = manifold.dim - n
    if odd or n == 0 or any(s.ambient.stop > D for s in manifold.spheres):
        raise ValueError(
            "the model is over [x, v], points and their velocities (see with_velocity): D + n dimensions, of which "
            f"the last n are Euclidean, such as R3 x S3 x R6; got {manifold}"
        )
    return manifold.subset(range(D))
