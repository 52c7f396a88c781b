# SPDX-License-Identifier: Apache-2.0
"""`AimProgress`: whether joints that move get to what they aim at, and in words why not."""

from __future__ import annotations

import numpy as np

from tpgmm_core.control.following import size
from tpgmm_core.control.joint_motion import JointStep

#: An aim that is missed cannot be reached where it comes no nearer by this share for so long, s.
NEARER, PATIENCE = 0.05, 1.0


class AimProgress:
    """See the module; one for each movement."""

    def __init__(self) -> None:
        self._nearest, self._waited = np.inf, 0.0

    def hindered(self, step: JointStep, dt: float) -> str:
        """Why what is missed is not got to; empty while it is, or comes nearer. `dt` is since the last step, s."""
        if not step.lags:
            self._nearest, self._waited = np.inf, 0.0
            return ""
        farthest = max(step.lags, key=size)
        if (far := size(farthest)) < (1.0 - NEARER) * self._nearest:
            self._nearest, self._waited = far, 0.0
            return ""
        self._waited += dt
        if self._waited < PATIENCE:
            return ""
        limits = ", ".join(step.limits)
        cause = f"at the limits of {limits}" if limits else "it is out of reach, or other aims count more"
        return f"{farthest}, no progress: {cause}"
