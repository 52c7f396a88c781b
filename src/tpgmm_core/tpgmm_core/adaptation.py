# SPDX-License-Identifier: Apache-2.0
"""`Adapter`: a fitted model, prepared to meet new frames again and again (Eqs. 5 and 6)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core import kernels_adapt, kernels_regress
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.mixture import GaussianMixture
from tpgmm_core.quaternion import Array

if TYPE_CHECKING:
    from tpgmm_core.tpgmm import TPGMM

UNCONSTRAINED_VARIANCE = 1e6
"""Variance, in squared units of the data, with which a direction that no frame constrains stays at the state.

Frames that say less than this of a direction are completed to it, so that a frame whose weight fades to
nothing leaves without a jump; what is surer than this (a standard deviation below 1000 units) is not
changed at all.
"""


class Adapter:
    """A fitted model with its precisions computed ahead; makes the mixture, or regression on it, for new
    frames.

    In precision form frame j contributes weight_j (A_j^+)^T Lambda_j A_j^+ at A_j mu_j + b_j, for any A: it
    says nothing about directions outside the range of its A. The constructor makes sure that everything is
    compiled, so that no later step waits for the compiler.
    """

    def __init__(self, model: TPGMM) -> None:
        self.frame_names = model.frame_names_
        self.manifold = model.manifold_
        self.priors = model.priors_
        manifolds = model.frame_manifolds_
        P, K = len(self.frame_names), len(model.priors_)
        D_max = max(m.dim for m in manifolds.values())
        n_max = max(m.tangent_dim for m in manifolds.values())
        self._log_priors = np.log(np.maximum(model.priors_, np.finfo(float).tiny))
        self._sizes = np.array([[manifolds[name].dim, manifolds[name].tangent_dim] for name in self.frame_names])
        self._means = np.zeros((P, D_max, K))
        self._precisions = np.zeros((P, n_max, n_max * K))
        for j, name in enumerate(self.frame_names):
            D_j, n_j = self._sizes[j]
            self._means[j, :D_j] = model.means_[name].T
            for k in range(K):
                g = Gaussian(model.means_[name][k], model.covariances_[name][k], manifolds[name])
                self._precisions[j, :n_j, k : n_j * K : K] = g.precision
        self._index = {name: j for j, name in enumerate(self.frame_names)}
        self._shape(self.manifold)
        if self.manifold.tangent_dim > 1:
            self._compile()

    def _shape(self, manifold: Manifold) -> None:
        """Arrays for frames that map to this space."""
        P, D_max, K = self._means.shape
        n = manifold.tangent_dim
        self.manifold = manifold
        self._A = np.zeros((P, manifold.dim, D_max))
        b = np.zeros((P, manifold.dim))
        self._A_of = [A[:, :D_j] for A, (D_j, _) in zip(self._A, self._sizes, strict=True)]
        self._b_of = list(b)
        self._weights = np.zeros(P)
        self._origin = np.zeros(manifold.dim)
        for s in manifold.spheres:
            self._origin[s.ambient] = [0.0, 0.0, 0.0, 1.0]
        self._means_out = np.zeros((K, manifold.dim))
        self._covariances_out = np.zeros((K, n, n))
        layout = self._sizes, manifold.ambient_of_tangent, manifold.sphere_starts
        self._situation = self._means, self._precisions, *layout, self._A, b, self._weights
        self._result = 1.0 / UNCONSTRAINED_VARIANCE, self._means_out, self._covariances_out

    def _compile(self) -> None:
        """One step with identity frames."""
        D = self.manifold.dim
        frames = {
            name: Frame(np.eye(D, size), np.zeros(D))
            for name, (size, _) in zip(self.frame_names, self._sizes, strict=True)
        }
        self.adapt(frames)
        if self.manifold.ambient_of_tangent[0] == 0:
            self.adapt_and_condition(frames, np.zeros(1))
            self.condition(np.zeros(1))

    def adapt(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> GaussianMixture:
        """The mixture with means and covariances of Eq. (6), in the space that the frames map to.

        frames : any of the model's frames by name, at least one; those that are missing contribute nothing
        state : shape (D,), where the robot is; zeros (and no turn) where None. A direction that no frame
            constrains stays there, with UNCONSTRAINED_VARIANCE
        weights : how far each frame is trusted, 0 to 1; 1 where not named

        Raises ValueError for unknown names, matrices that do not fit, time-varying frames, and weights
        outside 0..1.
        """
        where = self._set(frames, state, weights)
        self._check(kernels_adapt.adapt(*self._situation, where, *self._result))
        return GaussianMixture(self.priors, self._means_out.copy(), self._covariances_out.copy(), self.manifold)

    def adapt_and_condition(
        self,
        frames: Mapping[str, Frame],
        times: ArrayLike,
        weights: Mapping[str, float] | None = None,
        state: ArrayLike | None = None,
    ) -> tuple[Array, Array, Array]:
        """One step of a reproduction: adapt, then regression on the first dimension at times (H,).

        Returns means (H, D - 1), covariances (H, n - 1, n - 1) and the components' activations (K,) at the
        first of the times, the same as `adapt(...).condition([0], [t])`. Raises like `adapt`.
        """
        where = self._set(frames, state, weights)
        times = np.asarray(times, dtype=float)
        means, covariances, activations = outputs = self._outputs(len(times))
        failed = kernels_regress.adapt_and_regress(
            *self._situation, where, *self._result, self._log_priors, times, *outputs
        )
        self._check(failed)
        return means, covariances, activations[0]

    def condition(self, times: ArrayLike) -> tuple[Array, Array, Array]:
        """Regression at times (H,) in the situation of the last call, without adapting to it again."""
        times = np.asarray(times, dtype=float)
        means, covariances, activations = outputs = self._outputs(len(times))
        layout = self.manifold.ambient_of_tangent, self.manifold.sphere_starts
        kernels_regress.regress_all(self._log_priors, self._means_out, self._covariances_out, *layout, times, *outputs)
        return means, covariances, activations[0]

    def _outputs(self, H: int) -> tuple[Array, Array, Array]:
        """Means, covariances and activations of a regression at H times, still to be filled in."""
        manifold = self.manifold
        if manifold.ambient_of_tangent[0] != 0 or manifold.tangent_dim < 2:
            raise ValueError(f"regression over time needs time as the first dimension, then others, got {manifold}")
        n = manifold.tangent_dim - 1
        return np.empty((H, manifold.dim - 1)), np.empty((H, n, n)), np.empty((H, len(self.priors)))

    def _set(self, frames: Mapping[str, Frame], state: ArrayLike | None, weights: Mapping[str, float] | None) -> Array:
        """Copy the situation to where the kernels read it; returns the state."""
        if not frames:
            raise ValueError(f"adapt needs at least one of the frames {list(self.frame_names)}")
        self._weights[:] = 0.0
        for name, frame in frames.items():
            j = self._index.get(name)
            if j is None:
                raise ValueError(f"unknown frame {name!r}; the model knows {list(self.frame_names)}")
            if frame.A.shape != self._A_of[j].shape:
                self._reshape(name, frame, j)
            self._A_of[j][...] = frame.A
            self._b_of[j][...] = frame.b
            self._weights[j] = 1.0
        for name, weight in (weights or {}).items():
            if name not in self._index:
                raise ValueError(f"weights name the unknown frame {name!r}; the model knows {list(self.frame_names)}")
            if not 0.0 <= weight <= 1.0:
                raise ValueError(f"the weight of a frame is 0 to 1, {name!r} has {weight!r}")
            if name in frames:
                self._weights[self._index[name]] = weight
        if state is None:
            return self._origin
        where = np.array(state, dtype=float)
        if where.shape != self._origin.shape or not np.all(np.isfinite(where)):
            raise ValueError(f"the state has shape {self._origin.shape} and is finite, got {state!r}")
        return where

    def _reshape(self, name: str, frame: Frame, j: int) -> None:
        """Make place for frames that map to another R^D than the former ones, or say why this one does not fit."""
        if frame.is_time_varying:
            raise ValueError(f"frame {name!r} varies with time: choose one time step with frame.at(t_index)")
        D, D_j = frame.A.shape
        if D_j != self._sizes[j, 0]:
            raise ValueError(f"frame {name!r} has A of {D_j} columns, the model has {self._sizes[j, 0]} dimensions")
        if not self.manifold.is_euclidean or self._weights.any():
            raise ValueError(f"frame {name!r} maps to {D} dimensions, the others to {self.manifold.dim}")
        self._shape(Manifold.euclidean(D))

    def _check(self, failed: int) -> None:
        if failed >= 0:
            D_j = self._sizes[failed, 0]
            self.manifold.tangent_map(self._A[failed, :, :D_j])  # raises, and says why
            raise ValueError(f"frame {self.frame_names[failed]!r} does not fit the manifold {self.manifold}")
