# SPDX-License-Identifier: Apache-2.0
"""`python -m tpgmm_core.warm_up`: compiles all kernels once; numba keeps the result on disk.

On more than one core two processes share the work: one learns and adapts, the other one controls, and then steps
through movements, for which the first one has compiled most by then.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tpgmm_core import TPGMM, Adapter, Demonstration, Frame, Gaussian, GaussianMixture
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.tasks import compile_kernels
from tpgmm_core.learning.endpoints import EndpointTPGMM
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.observation.pose_filter import PoseFilter
from tpgmm_core.recognition.skill import Skill, SkillFilter
from tpgmm_core.retrieval.dynamical_system import StableDynamics
from tpgmm_core.retrieval.regression import RegressThenProduct
from tpgmm_core.retrieval.semi_markov import SemiMarkovMovement
from tpgmm_core.retrieval.time_steps import TimeSteps
from tpgmm_core.retrieval.trajectory import TrajectoryModel

type Tell = Callable[[str], None]


def warm_up(tell: Tell = lambda words: None) -> None:
    """Run every compiled path on a small problem, so that neither a fit nor a control step waits for the compiler.

    Parameters
    ----------
    tell
        called with a few words about what is compiled next: the first time takes minutes
    """
    learning(tell)
    control(tell)
    retrieval(tell)


def learning(tell: Tell) -> None:
    """Compile what learns, adapts and regresses."""
    tell("EM of full covariances, adaptation, regression")
    model = small_model()
    mixture = Adapter(model).adapt({"frame": Frame(np.eye(8), np.zeros(8))})
    Gaussian.product([mixture.component(0), mixture.component(1)])
    Adapter(model).condition([0.5])
    for fitted in (mixture, GaussianMixture([1.0], np.zeros((1, 2)), np.eye(2)[None])):
        fitted.condition([0], [0.5])
    model.metadata_ = {"duration_s": 1.0}
    SkillFilter(Skill("skill", RegressThenProduct(model)), 5, 1.0)
    PoseFilter.compile_kernels()
    pose = samples()[:, 1:]
    POSE.exp(pose[0], POSE.log(pose[0], pose[1]))
    POSE.transport(pose[0], pose[1])


def control(tell: Tell) -> None:
    """Compile what controls."""
    tell("linear-quadratic regulators")
    import tpgmm_core.lqr.double_integrator
    import tpgmm_core.lqr.finite_horizon  # noqa: F401  these compile on import

    tell("kinematic frames, control laws")
    compile_kernels()
    warm_up_control()


def retrieval(tell: Tell) -> None:
    """Compile the retrieval methods that step through a movement, and what they learn."""
    tell("hidden Markov and semi-Markov models")
    X = samples()
    chain = TPHSMM(n_components=2, max_iter=1).fit_projected({"frame": X})
    chain.chain_.most_likely(np.zeros((40, 2)), [40])
    chain.metadata_ = {"duration_s": 1.0}
    SemiMarkovMovement(chain)
    markov = TPHMM(n_components=2, max_iter=1).fit_projected({"frame": X})
    markov.chain_.most_likely(np.zeros((40, 2)), [40])
    steps = X[np.argsort(X[:, 0])]
    still = {"frame": Frame(np.eye(8), np.zeros(8))}
    shown = [Demonstration(steps[:, 0], steps, still) for _ in range(2)]
    TimeSteps(TimeStepTPGMM(n_steps=3, manifold="R1 x R3 x S3", locality=1.0).fit(shown))
    tell("trajectories")
    rng = np.random.default_rng(1)
    features = np.concatenate([X, rng.normal(size=(40, 12))], axis=1)
    TrajectoryModel(TPGMM(n_components=2, manifold="R1 x R3 x S3 x R12", max_iter=1).fit_projected({"frame": features}))
    tell("dynamical systems")
    moving = np.concatenate([X[:, 1:], rng.normal(size=(40, 6))], axis=1)
    velocities = EndpointTPGMM(n_components=2, manifold="R3 x S3 x R6", max_iter=1).fit_projected({"frame": moving})
    StableDynamics(velocities, duration=1.0)


def samples() -> Array:
    """Times and poses, (40, 8)."""
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 1.0, 40)[:, None]
    pose = np.concatenate([rng.normal(size=(40, 3)), 0.1 * rng.normal(size=(40, 3)), np.ones((40, 1))], axis=1)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    return np.concatenate([time, pose], axis=1)


def small_model() -> TPGMM:
    """A model of them, in one frame."""
    return TPGMM(n_components=2, manifold="R1 x R3 x S3", max_iter=1).fit_projected({"frame": samples()})


def warm_up_control() -> None:
    """Run the controller on the smallest of arms, so that it is compiled; nothing where Pinocchio is not installed."""
    try:
        from tpgmm_core.control.laws import LAWS, ReferenceLaw
        from tpgmm_core.control.supervised_controller import SupervisedController
        from tpgmm_core.robot.model import RobotModel
    except ImportError:
        return
    with tempfile.TemporaryDirectory() as directory:
        (Path(directory) / "arm.urdf").write_text(ARM_URDF)
        (Path(directory) / "arm.yaml").write_text(ARM)
        robot = RobotModel.from_file(Path(directory) / "arm.yaml")
        for name in LAWS:
            with contextlib.suppress(ImportError):  # the solver of predictive control is optional
                SupervisedController(robot, ReferenceLaw(name, robot, "hand"))


LINK = """<link name="{name}"><inertial><mass value="1"/><origin xyz="1 0 0"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="to_{name}" type="revolute"><parent link="{parent}"/><child link="{name}"/><axis xyz="0 0 1"/>
<origin xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
ARM_URDF = f"""<robot name="arm"><link name="base"/>{LINK.format(name="elbow", parent="base")}
{LINK.format(name="hand", parent="elbow")}</robot>"""
ARM = """{urdf: arm.urdf, base_frame: base, joint_groups: {arm: [to_elbow, to_hand]},
endpoints: {hand: {frame: hand, joints: arm}}, home: {to_elbow: 0.0, to_hand: 0.0}}"""


def main(parts: Sequence[str]) -> int:
    """Compile all parts, in two processes where there are two cores, or those that are named; the exit status."""

    def tell(words: str) -> None:
        print(f"compiling: {words}", flush=True)

    if parts:
        for part in parts:
            {"control": control, "retrieval": retrieval}[part](tell)
        return 0
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    if cores < 2:
        warm_up(tell)
        return 0
    command = [sys.executable, "-m", "tpgmm_core.warm_up", "control", "retrieval"]
    with subprocess.Popen(command) as other:
        learning(tell)
    return other.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
