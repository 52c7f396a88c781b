# SPDX-License-Identifier: Apache-2.0
"""`python -m tpgmm_core.warm_up`: compiles all kernels once; numba keeps the result on disk."""

from __future__ import annotations

import numpy as np

import tpgmm_core.control.finite_horizon
import tpgmm_core.control.lqr  # noqa: F401  these two compile on import
from tpgmm_core import TPGMM, Adapter, Frame, Gaussian
from tpgmm_core.learning.ends import GoalTPGMM
from tpgmm_core.learning.hmm import TPHMM
from tpgmm_core.learning.hsmm import TPHSMM
from tpgmm_core.manifold import POSE
from tpgmm_core.retrieval.dynamics import StableDynamics
from tpgmm_core.retrieval.regression import RegressThenProduct
from tpgmm_core.retrieval.semi_markov import SemiMarkovMovement


def warm_up() -> None:
    """Run every compiled path on a small problem, so that neither a fit nor a control step waits for the
    compiler.
    """
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 1.0, 40)[:, None]
    pose = np.concatenate([rng.normal(size=(40, 3)), 0.1 * rng.normal(size=(40, 3)), np.ones((40, 1))], axis=1)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    X = np.concatenate([time, pose], axis=1)
    model = TPGMM(n_components=2, manifold="R1 x R3 x S3", max_iter=1).fit_projected({"frame": X})
    mixture = Adapter(model).adapt({"frame": Frame(np.eye(8), np.zeros(8))})
    Gaussian.product([mixture.component(0), mixture.component(1)])
    Adapter(model).condition([0.5])
    RegressThenProduct(model)
    POSE.exp(pose[0], POSE.log(pose[0], pose[1]))
    moving = np.concatenate([pose, rng.normal(size=(40, 6))], axis=1)
    velocities = GoalTPGMM(n_components=2, manifold="R3 x S3 x R6", max_iter=1).fit_projected({"frame": moving})
    StableDynamics(velocities, duration=1.0)
    chain = TPHSMM(n_components=2, max_iter=1).fit_projected({"frame": X})
    chain.chain_.most_likely(np.zeros((40, 2)), [40])
    chain.metadata_ = {"duration_s": 1.0}
    SemiMarkovMovement(chain)
    markov = TPHMM(n_components=2, max_iter=1).fit_projected({"frame": X})
    markov.chain_.most_likely(np.zeros((40, 2)), [40])


if __name__ == "__main__":
    warm_up()
