# SPDX-License-Identifier: Apache-2.0
"""`python -m tpgmm_core.warm_up`: compiles all kernels once; numba keeps the result on disk."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import tpgmm_core.lqr.double_integrator  # noqa: F401  these two compile on import
from tpgmm_core import TPGMM, Adapter, Frame, Gaussian
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.tasks import compile_kernels
from tpgmm_core.learning.endpoints import EndpointTPGMM
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.observation.pose_filter import PoseFilter
from tpgmm_core.retrieval.dynamical_system import StableDynamics
from tpgmm_core.retrieval.regression import RegressThenProduct
from tpgmm_core.retrieval.semi_markov import SemiMarkovMovement
from tpgmm_core.retrieval.time_steps import TimeSteps
from tpgmm_core.retrieval.trajectory import TrajectoryModel


def warm_up(tell: Callable[[str], None] = lambda words: None) -> None:
    """Run every compiled path on a small problem, so that neither a fit nor a control step waits for the compiler.

    Parameters
    ----------
    tell
        called with a few words about what is compiled next: the first time takes minutes
    """
    tell("EM of full covariances, adaptation, regression")
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 1.0, 40)[:, None]
    pose = np.concatenate([rng.normal(size=(40, 3)), 0.1 * rng.normal(size=(40, 3)), np.ones((40, 1))], axis=1)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    X = np.concatenate([time, pose], axis=1)
    model = TPGMM(n_components=2, manifold="R1 x R3 x S3", max_iter=1).fit_projected({"frame": X})
    mixture = Adapter(model).adapt({"frame": Frame(np.eye(8), np.zeros(8))})
    Gaussian.product([mixture.component(0), mixture.component(1)])
    Adapter(model).condition([0.5])
    mixture.condition([0], [0.5])
    RegressThenProduct(model)
    PoseFilter.compile_kernels()
    POSE.exp(pose[0], POSE.log(pose[0], pose[1]))
    steps = X[np.argsort(X[:, 0])]
    TimeSteps(TimeStepTPGMM(n_steps=3, manifold="R1 x R3 x S3").fit_projected({"frame": steps}))
    tell("dynamical systems")
    moving = np.concatenate([pose, rng.normal(size=(40, 6))], axis=1)
    velocities = EndpointTPGMM(n_components=2, manifold="R3 x S3 x R6", max_iter=1).fit_projected({"frame": moving})
    StableDynamics(velocities, duration=1.0)
    tell("trajectories")
    features = np.concatenate([X, rng.normal(size=(40, 12))], axis=1)
    TrajectoryModel(TPGMM(n_components=2, manifold="R1 x R3 x S3 x R12", max_iter=1).fit_projected({"frame": features}))
    tell("hidden Markov and semi-Markov models")
    chain = TPHSMM(n_components=2, max_iter=1).fit_projected({"frame": X})
    chain.chain_.most_likely(np.zeros((40, 2)), [40])
    chain.metadata_ = {"duration_s": 1.0}
    SemiMarkovMovement(chain)
    markov = TPHMM(n_components=2, max_iter=1).fit_projected({"frame": X})
    markov.chain_.most_likely(np.zeros((40, 2)), [40])
    tell("kinematic frames, control laws")
    compile_kernels()
    warm_up_control()


def warm_up_control() -> None:
    """Run the controller on the smallest of arms, so that it is compiled; nothing where Pinocchio is not installed."""
    try:
        from tpgmm_core.control.controller import Controller
        from tpgmm_core.control.laws import LAWS, ReferenceLaw
        from tpgmm_core.robot.model import RobotModel
    except ImportError:
        return
    with tempfile.TemporaryDirectory() as directory:
        (Path(directory) / "arm.urdf").write_text(ARM_URDF)
        (Path(directory) / "arm.yaml").write_text(ARM)
        robot = RobotModel.from_file(Path(directory) / "arm.yaml")
        for name in LAWS:
            with contextlib.suppress(ImportError):  # the solver of predictive control is optional
                Controller(robot, ReferenceLaw(name, robot, "hand"))


LINK = """<link name="{name}"><inertial><mass value="1"/><origin xyz="1 0 0"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="to_{name}" type="revolute"><parent link="{parent}"/><child link="{name}"/><axis xyz="0 0 1"/>
<origin xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
ARM_URDF = f"""<robot name="arm"><link name="base"/>{LINK.format(name="elbow", parent="base")}
{LINK.format(name="hand", parent="elbow")}</robot>"""
ARM = """{urdf: arm.urdf, base_frame: base, joint_groups: {arm: [to_elbow, to_hand]},
endpoints: {hand: {frame: hand, joints: arm}}, home: {to_elbow: 0.0, to_hand: 0.0}}"""


if __name__ == "__main__":
    warm_up(lambda words: print(f"compiling: {words}", flush=True))
