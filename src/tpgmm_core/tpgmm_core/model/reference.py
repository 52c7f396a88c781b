# SPDX-License-Identifier: Apache-2.0
"""`Reference`: what a reproduction sends and a controller follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian


@dataclass(frozen=True, slots=True)
class Reference:
    """One step of a reproduction.

    Parameters
    ----------
    phase
        0 at the start of the movement, 1 at its end
    gaussian
        where to be and how much it matters, without the time dimension
    horizon_time_step
        s between the Gaussians of the horizon; 0 where there is none
    horizon
        the Gaussians ahead, the first one ``horizon_time_step`` after this step
    activations
        shape (K,), the weights of the components at this time
    frames
        names of the frames that were used
    dimensions
        names of the mean's coordinates; empty for a pose
    waits
        why the movement waits where it is, in words; empty: it does not
    """

    phase: float
    gaussian: Gaussian
    horizon_time_step: float
    horizon: tuple[Gaussian, ...]
    activations: Array
    frames: tuple[str, ...]
    dimensions: tuple[str, ...] = ()
    waits: str = ""

    def velocity(self) -> Array:
        """Velocity (D_tangent,) of the mean towards the next Gaussian of the horizon; zero where there is none."""
        mean, manifold = self.gaussian.mean, self.gaussian.manifold
        if not self.horizon:
            return np.zeros(manifold.tangent_dim)
        return manifold.log(mean, self.horizon[0].mean) / self.horizon_time_step
