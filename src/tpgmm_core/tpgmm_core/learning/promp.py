# SPDX-License-Identifier: Apache-2.0
"""`ProMPTPGMM`: a probabilistic movement primitive in each frame, fused by the product of Gaussians.

A probabilistic movement primitive (Paraschos et al., NIPS 2013) describes each demonstration, as seen from a frame, by
the weights of B basis functions of time, y(t) = (phi(t)^T kron I) w + e, and the demonstrations by one Gaussian of the
weights, w ~ N(mu_w, Sigma_w), with e ~ N(0, Sigma_y). At a time, that is the Gaussian

    N((phi^T kron I) mu_w, (phi^T kron I) Sigma_w (phi kron I) + Sigma_y),

a local measure of uncertainty, which is all that the product over the frames needs (Section 7). Sigma_w is a full
covariance of B n dimensions out of m demonstrations. As for time steps (`tpgmm_core.learning.time_steps`), it is shrunk
towards the covariance between the weights of basis functions that is the same in all directions of a place and of a
turn, and widened as the Student distribution asks for. Both are linear in Sigma_w, so that the Gaussians at the steps
are computed, and Sigma_w itself never is.

Basis functions are Gaussians of time, a spacing wide, divided by their sum. Weights are those of least squares: paths
at rest are kept, and so is where a movement ends. On S³ a demonstration is a tangent vector at each point of the mean
path, in fixed axes. What the basis functions cannot follow (noise, tremor) is Sigma_y.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.shown_to_frame import ShownToFrame, isotropic
from tpgmm_core.learning.smooth_paths import smoothed
from tpgmm_core.learning.step_mixture import UNSEEN
from tpgmm_core.learning.time_steps import TimeStepTPGMM


@dataclass(eq=False, repr=False)
class ProMPTPGMM(TimeStepTPGMM):
    """Probabilistic movement primitives in all frames, as a Gaussian for each time step and frame.

    Parameters and attributes that are not listed here are those of `TimeStepTPGMM`.

    Parameters
    ----------
    n_basis
        number of basis functions, from 2 to `n_steps`: the more, the finer the details that are kept
    """

    n_basis: int = 20

    def _gaussians(self, shown: ShownToFrame) -> tuple[Array, Array]:
        return gaussians_of_weights(shown, basis(self.n_steps, self.n_basis), self._predictive)

    def _deviations(self, shown: ShownToFrame, centres: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Those that the basis functions follow, of the demonstrations that the frame saw at some time."""
        phi, known = basis(self.n_steps, self.n_basis), shown.visible.any(axis=1)
        found = np.zeros((len(known), self.n_steps, shown.space.tangent_dim))
        deviations = shown.space.log(centres[None], shown.held())
        found[known] = np.einsum("ts,msn->mtn", phi @ np.linalg.pinv(phi), deviations)
        return found, known[:, None] & shown.visible.any(axis=0)

    def _check_parameters(self) -> None:
        super()._check_parameters()
        self._check_integers("n_basis", least=2)
        if self.n_basis > self.n_steps:
            raise ValueError(f"n_basis is an integer from 2 to n_steps = {self.n_steps}, got {self.n_basis}")


def gaussians_of_weights(
    shown: ShownToFrame, phi: Array, predictive: Callable[[Manifold, Array], Array]
) -> tuple[Array, Array]:
    """What basis functions make of what one frame was shown.

    Parameters
    ----------
    shown
        m demonstrations at T steps
    phi
        (T, B), the basis functions at the steps
    predictive
        covariance (n, n) of the next point, from a space and the tangent vectors (m, n) of those before

    Returns
    -------
    tuple[Array, Array]
        means (T, D) and covariances (T, n, n), without time
    """
    space, points = shown.space, shown.held()
    n_steps, n_basis = phi.shape
    weights_of = np.linalg.pinv(phi)
    H = np.broadcast_to(phi @ weights_of, (space.tangent_dim, n_steps, n_steps))
    centres = smoothed(space, np.stack([space.mean(p) for p in points.swapaxes(0, 1)]), H)
    deviations = space.log(centres[None], points)  # (m, T, n)
    w = np.einsum("bt,mtn->mbn", weights_of, deviations)
    centres = space.exp(centres, phi @ w.mean(axis=0))
    followed = np.einsum("tb,mbn->mtn", phi, w - w.mean(axis=0))
    left = deviations - np.einsum("tb,mbn->mtn", phi, w)
    freedom = len(points) * max(n_steps - n_basis, 1)
    noise = isotropic(space, np.einsum("mtn,mto->no", left, left) / freedom)
    within = np.empty((n_steps, space.tangent_dim, space.tangent_dim))
    for t, centre in enumerate(centres):
        spread = followed[:, t] if len(points) > 1 else space.log(centre, shown.everything)
        within[t] = predictive(space, spread) + noise
    within[~shown.visible.any(axis=0)] *= UNSEEN
    return centres, within


def basis(n_steps: int, n_basis: int) -> Array:
    """Basis functions (T, B) at steps from 0 to 1; the values at each step add up to 1."""
    centres = np.linspace(0.0, 1.0, n_basis)
    from_centres = (np.linspace(0.0, 1.0, n_steps)[:, None] - centres) * (n_basis - 1)
    values = np.exp(-0.5 * from_centres**2)
    return np.asarray(values / values.sum(axis=1, keepdims=True))
