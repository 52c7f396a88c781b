# SPDX-License-Identifier: Apache-2.0
"""Task-parameterized Gaussian mixture models: mathematics without ROS."""

from tpgmm_core.adaptation import Adapter
from tpgmm_core.demonstration import Demonstration
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian, Gaussians
from tpgmm_core.manifold import Manifold
from tpgmm_core.mixture import GaussianMixture
from tpgmm_core.model_file import ModelFileError
from tpgmm_core.tpgmm import TPGMM

__all__ = [
    "TPGMM",
    "Adapter",
    "Demonstration",
    "Frame",
    "Gaussian",
    "GaussianMixture",
    "Gaussians",
    "Manifold",
    "ModelFileError",
]
