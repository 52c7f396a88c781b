# SPDX-License-Identifier: Apache-2.0
"""Task-parameterized Gaussian mixture models: mathematics without ROS."""

from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian, Gaussians
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.model_file import ModelFileError
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.demonstration import Demonstration

__all__ = [
    "TPGMM",
    "LearnedMixture",
    "Adapter",
    "Demonstration",
    "Frame",
    "Gaussian",
    "GaussianMixture",
    "Gaussians",
    "Manifold",
    "ModelFileError",
]
