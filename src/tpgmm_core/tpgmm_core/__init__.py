# SPDX-License-Identifier: Apache-2.0
"""Task-parameterized Gaussian mixture models: mathematics without ROS."""

from tpgmm_core.demonstration import Demonstration
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold

__all__ = ["Demonstration", "Frame", "Gaussian", "Manifold"]
