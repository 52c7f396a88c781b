# SPDX-License-Identifier: Apache-2.0
"""Eqs. (7) to (12) in one model, on Baxter's left arm: which constraint counted when.

Demonstrations with four phases: a rest posture (7); the hand above a cup (9), the elbow at a place in the world as far
as that leaves it (11); the hand at a place in the world (8), turned to a lamp below that (12); the hand above the cup
(9), the rest posture below that (10). What is not asked for wanders; cup and lamp are in different places each time.
The model is told neither phases nor constraints; the picture shows how many of the seven directions each frame
determines. Constraints that follow from each other share them: an elbow that is always at the same place is seen in the
joints as well.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from examples.report import progress, write_report  # noqa: E402
from tpgmm_core import TPGMM, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.kinematics.frames import (  # noqa: E402
    JointSpace,
    KinematicFrame,
    NullSpace,
    SecondaryTaskSpace,
    TaskSpace,
)
from tpgmm_core.kinematics.inverse import THRESHOLD, damped_pseudo_inverse, null_space  # noqa: E402
from tpgmm_core.kinematics.moving import ConfigurationProduct, MovingFrames  # noqa: E402
from tpgmm_core.kinematics.relevance import directions_determined  # noqa: E402
from tpgmm_core.kinematics.tasks import KinematicState, KinematicTask  # noqa: E402
from tpgmm_core.kinematics.urdf import UrdfKinematics  # noqa: E402
from tpgmm_core.robot.model import RobotModel  # noqa: E402

HAND, AT_CUP = KinematicTask("hand"), KinematicTask("hand", "position", "cup")
TO_LAMP, ELBOW = KinematicTask("hand", "orientation", "lamp"), KinematicTask("elbow")
CANDIDATES: dict[str, KinematicFrame] = {
    "(7) joints": JointSpace(),
    "(8) hand in the world": TaskSpace((HAND,)),
    "(9) hand at the cup": TaskSpace((AT_CUP,)),
    "(10) joints below the hand": NullSpace((HAND,)),
    "(11) elbow below the hand": SecondaryTaskSpace((ELBOW,), (HAND,), least_error=True),
    "(12) to the lamp below the hand": SecondaryTaskSpace((TO_LAMP,), (HAND,), least_error=True),
}
PHASES = [["(7)"], ["(9)", "(11)"], ["(8)", "(12)"], ["(9)", "(10)"]]
#: What in each phase has nothing to do with what was asked for
FOREIGN = [["(9)", "(12)"], ["(8)", "(12)"], ["(9)", "(11)"], ["(8)", "(11)", "(12)"]]
PHASE, RATE = 2.0, 25.0  # s, samples per s
ABOVE_CUP = np.array([0.0, 0.0, 0.1])  # m
APPROACH = 0.2  # share of an error that one sample undoes
NOISE = 0.003  # m and rad
COLOURS = ("#444444", "#1b9e77", "#d95f02", "#7570b3", "#e7298a", "#66a61e")


def situation(rng: np.random.Generator, hand: Array) -> dict[str, Frame]:
    """Cup and lamp about the hand's pose (7,) at rest."""
    turn = quaternion.multiply(quaternion.exp(rng.uniform(-0.4, 0.4, 3)), hand[3:])
    cup = hand[:3] - ABOVE_CUP + rng.uniform(-0.12, 0.12, 3)
    return {"cup": Frame.from_pose(cup, [0.0, 0.0, 0.0, 1.0]), "lamp": Frame.from_pose(cup, turn)}


def demonstration(robot: UrdfKinematics, rest: Array, objects: Mapping[str, Frame], rng: np.random.Generator) -> Array:
    """Configurations (T, 7), by priorities level over level; the last level wanders."""
    robot.update(rest)
    place, elbow = robot.place("hand")[:3] + [0.0, 0.08, -0.06], robot.place("elbow")[:3] + [0.0, 0.03, 0.03]
    q, configurations = rest + 0.1 * rng.normal(size=7), []
    wander = np.zeros(7)
    for t in range(int(len(PHASES) * PHASE * RATE)):
        wander += 0.2 * (0.03 * rng.normal(size=7) - 0.1 * wander)
        moment = KinematicState(robot, q, objects)
        goals = {
            "(7)": (np.eye(7), rest - q),
            "(8)": (moment.view((HAND,)).J, moment.view((HAND,)).offset + place),
            "(9)": (moment.view((AT_CUP,)).J, moment.view((AT_CUP,)).offset + ABOVE_CUP),
            "(10)": (np.eye(7), rest - q),
            "(11)": (moment.view((ELBOW,)).J, moment.view((ELBOW,)).offset + elbow),
            "(12)": (moment.view((TO_LAMP,)).J, moment.view((TO_LAMP,)).offset),
        }
        step, N, above = np.zeros(7), np.eye(7), np.zeros((0, 7))
        for name in PHASES[int(t / (PHASE * RATE))]:
            J, e = goals[name]
            e = APPROACH * (e + NOISE * rng.normal(size=len(e)))
            step = step + damped_pseudo_inverse(J @ N, THRESHOLD) @ (e - J @ step)
            above = np.concatenate([above, J])
            N = null_space(above, THRESHOLD)
        q = q + step + N @ wander
        configurations.append(q)
    return np.stack(configurations)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/kinematic_relevance"), help="of report and picture")
    parser.add_argument("--seed", type=int, default=1, help="of the demonstrations (default: %(default)s)")
    parser.add_argument("--demonstrations", type=int, default=8, help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    baxter = RobotModel.from_file(Path(__file__).resolve().parents[1] / "config" / "baxter.yaml")
    ends = {"hand": "left_gripper", "elbow": "left_lower_elbow"}
    robot = UrdfKinematics(baxter, "left_arm", ends)
    rest = baxter.home[baxter.indices("left_arm")]
    robot.update(rest)
    hand = robot.place("hand")
    frames = MovingFrames(robot, CANDIDATES)
    times = np.arange(int(len(PHASES) * PHASE * RATE)) / RATE
    shown = []
    for _ in range(options.demonstrations):
        objects = situation(rng, hand)
        shown.append(frames.demonstration(times, demonstration(robot, rest, objects, rng), objects, with_time=True))
    model = TPGMM(12, reg_covar=1e-5).fit(shown)

    objects, q = situation(rng, hand), rest
    product = ConfigurationProduct(model, frames)
    courses: dict[str, list[float]] = {name: [] for name in CANDIDATES}
    at_cup = []
    for t in progress(times.tolist(), "steps of the reproduction"):
        now = frames.at(q, objects)
        for name, directions in directions_determined(model, now, t).items():
            courses[name].append(directions)
        q = product.step(q, objects, t).mean
        robot.update(q)
        at_cup.append(float(np.linalg.norm(robot.place("hand")[:3] - objects["cup"].b[:3] - ABOVE_CUP)))

    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.stackplot(times, np.array(list(courses.values())), labels=list(courses), colors=COLOURS)
    axes.set(xlim=(0.0, times[-1]), ylim=(0.0, 7.0), xlabel="time (s)", ylabel="directions determined")
    for i, names in enumerate(PHASES):
        axes.axvline(i * PHASE, color="white", lw=1.0)
        axes.text((i + 0.5) * PHASE, 7.1, "shown: " + " over ".join(names), ha="center")
    figure.legend(loc="outside right upper")

    rows: list[Row] = []
    for i, names in enumerate(PHASES):
        late = slice(int((i + 0.5) * PHASE * RATE), int((i + 0.95) * PHASE * RATE))  # constraints need time to be met
        share = {name.split(" ")[0]: float(np.mean(course[late])) for name, course in courses.items()}
        first, foreign = share[names[0]], sum(share[name] for name in FOREIGN[i])
        above = {"hand_above_cup_m": float(np.median(at_cup[late])), "passed": bool(first > 2.5 and foreign < 0.5)}
        rows.append({"phase": i, "asked_for": " over ".join(names), **share, **above})
    write_report("report", rows, options.output)
    figure.savefig(options.output / "kinematic_relevance.png", dpi=80)
    print(f"picture: {options.output / 'kinematic_relevance.png'}")
    return 0 if all(row["passed"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
