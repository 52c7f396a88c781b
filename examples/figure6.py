# SPDX-License-Identifier: Apache-2.0
"""Figure 6 of the paper: priorities of a robot with two hands, learned from demonstrations.

Two objects move, one for each hand, and for some of the time both cannot be reached. In the demonstrations the robot
then makes a compromise, or gives priority to the left hand, or to the right one (first row). The model is told nothing
of this. It has the same candidate frames in all three cases, and is tried on new paths of the objects:

- with the frames of the paper and nothing else (second row): each hand at its object, Eq. (9), and each hand at its
  object as far as the other hand leaves it free, Eq. (12);
- with what this project adds (third row). "previous": how far joints go in a step, which keeps them from leaping.
  "least error": a hand that gives way stops where it is nearest to its object. "together": both hands as one task of
  equal rank, for compromises. "targets": hands aim at their objects, not at where they were kept from them.

Beside them stands a controller by hand that is told the order.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from examples.claims import at_least, at_most, canvas, finish, options_of
from examples.report import progress, write_report
from examples.two_hands import (
    DURATION,
    HANDS,
    START,
    STEPS,
    SUBSTEPS,
    THRESHOLD,
    Movement,
    by_hand,
    demonstration,
    errors,
    object_paths,
    out_of_reach,
)
from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.report import Row
from tpgmm_core.common.types import Array
from tpgmm_core.kinematics.chains import PlanarRobot, planar_bimanual
from tpgmm_core.kinematics.frames import KinematicFrame, PreviousConfiguration, SecondaryTaskSpace, TaskSpace
from tpgmm_core.kinematics.moving import ConfigurationProduct, MovingFrames
from tpgmm_core.kinematics.object_targets import target_object_origins
from tpgmm_core.kinematics.tasks import KinematicTask

#: Case → how much each hand's squared error counts in the demonstrations; the order that the controller by hand is told
CASES: dict[str, tuple[tuple[float, float], list[tuple[str, ...]]]] = {
    "compromise": ((1.0, 1.0), [("left", "right")]),
    "left first": ((1.0, 1e-4), [("left",), ("right",)]),
    "right first": ((1e-4, 1.0), [("right",), ("left",)]),
}
PAPER = "the paper's frames"
ALL = "+ targets"
#: What is added to the paper's frames, one after the other
VARIANTS = {
    PAPER: (),
    "+ previous": ("previous",),
    "+ least error": ("previous", "least error"),
    "+ together": ("previous", "least error", "together"),
    ALL: ("previous", "least error", "together", "targets"),
}
#: Of what is claimed: sum of the errors / told the order, and in compromises larger error / smaller, both at most
BOUNDS = {PAPER: (1.3, 2.0), ALL: (1.2, 1.2)}


def candidate_frames(added: Sequence[str]) -> dict[str, KinematicFrame]:
    """Eqs. (9) and (12) for both orders of the hands, and what is added to them."""
    left, right = (KinematicTask(hand, relative_to=f"{hand} object") for hand in HANDS)
    least_error = "least error" in added
    frames: dict[str, KinematicFrame] = {
        "left": TaskSpace((left,)),
        "right below left": SecondaryTaskSpace((right,), above=(left,), least_error=least_error),
        "right": TaskSpace((right,)),
        "left below right": SecondaryTaskSpace((left,), above=(right,), least_error=least_error),
    }
    if "together" in added:
        frames["left + right"] = TaskSpace((left, right))
    if "previous" in added:
        frames["previous"] = PreviousConfiguration()
    return frames


def objects_at(places: dict[str, Array]) -> dict[str, Frame]:
    """Objects that do not turn, from positions (2,) or (T, 2)."""
    return {f"{hand} object": Frame(np.eye(2), place) for hand, place in places.items()}


def learned(robot: PlanarRobot, added: Sequence[str], movements: Sequence[Movement]) -> ConfigurationProduct:
    """One Gaussian in each frame, and their product at each step, Eq. (6), over the joints."""
    frames = MovingFrames(robot, candidate_frames(added), THRESHOLD)
    times = np.linspace(0.0, DURATION, STEPS)
    shown = [frames.demonstration(times, m.q, objects_at(dict(m.objects))) for m in movements]
    model = TPGMM(1, reg_covar=1e-6).fit(shown)
    if "targets" in added:
        target_object_origins(model, model.frame_names_)
    return ConfigurationProduct(model, frames)


def reproduced(product: ConfigurationProduct, objects: dict[str, Array]) -> Movement:
    """The model on new paths: the objects stand still for some steps of the product."""
    q, configurations = START, []
    for t in range(STEPS):
        now = objects_at({hand: path[t] for hand, path in objects.items()})
        for _ in range(SUBSTEPS):
            q = product.step(q, now, dt=DURATION / (STEPS * SUBSTEPS)).mean
        configurations.append(q)
    return Movement(objects, np.stack(configurations))


def measured(robot: PlanarRobot, movements: Sequence[Movement], contested: NDArray[np.bool_]) -> dict[str, float]:
    """Mean errors while both objects cannot be reached, and how fast the fastest joint was."""
    left, right = np.concatenate([errors(robot, m) for m in movements])[contested].mean(axis=0)
    speed = max(np.abs(np.diff(m.q, axis=0)).max() for m in movements) * STEPS / DURATION
    return {"left_error_m": float(left), "right_error_m": float(right), "fastest_joint_rad_per_s": float(speed)}


def claims(case: str, variant: str, found: dict[str, float], told: dict[str, float]) -> list[Row]:
    """Who had priority in the demonstrations has it; the errors are about those of the controller that is told."""
    left, right = found["left_error_m"], found["right_error_m"]
    in_all, uneven = BOUNDS[variant]
    together = (left + right) / (told["left_error_m"] + told["right_error_m"])
    rows = [at_most(f"{variant}, {case}: sum of the errors / told the order", together, in_all)]
    if case == "compromise":
        ratio = max(left, right) / min(left, right)
        return [*rows, at_most(f"{variant}, {case}: larger error / smaller", ratio, uneven)]
    first, second = (left, right) if case == "left first" else (right, left)
    return [*rows, at_least(f"{variant}, {case}: error of the hand that gives way / the other", second / first, 5.0)]


def draw(axes: Axes, robot: PlanarRobot, movement: Movement, title: str) -> None:
    """The robot from light grey to black, the objects' paths in red."""
    for t in np.linspace(0, STEPS - 1, 9).astype(int):
        robot.update(movement.q[t])
        for hand in HANDS:
            axes.plot(*robot.way_to(hand).T, color=str(0.85 - 0.85 * t / STEPS), lw=3.0, solid_joinstyle="round")
    for path in movement.objects.values():
        axes.plot(*path.T, color="#c1121f", lw=2.0, zorder=5)
    axes.set(xlim=(-3.0, 3.0), ylim=(-0.2, 2.9), xticks=[], yticks=[], aspect="equal")
    axes.set_title(title, fontsize=11, loc="left")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = options_of(__doc__, "figure6")
    parser.add_argument("--paths", type=int, default=5, help="new paths of the objects (default: %(default)s)")
    parser.add_argument("--demonstrations", type=int, default=3, help="of each case (default: %(default)s)")
    parser.add_argument("--paper", action="store_true", help="the paper's frames alone")
    options = parser.parse_args(arguments)
    variants = {PAPER: VARIANTS[PAPER]} if options.paper else VARIANTS
    robot, rng = planar_bimanual(), np.random.default_rng(1)
    new = [object_paths(robot, rng) for _ in progress(range(options.paths), "new paths")]
    contested = np.concatenate([out_of_reach(robot, objects) for objects in new])

    figure = canvas(15.0, 3.0 * min(len(variants) + 1, 3))
    panels = figure.subplots(min(len(variants) + 1, 3), len(CASES))
    table: list[Row] = []
    rows: list[Row] = []
    for column, (case, (weights, order)) in enumerate(CASES.items()):
        shown = [demonstration(robot, weights, rng) for _ in progress(range(options.demonstrations), case)]
        draw(panels[0, column], robot, shown[0], f"{case}: a demonstration")
        told = measured(robot, [by_hand(robot, order, objects) for objects in new], contested)
        table.append({"case": case, "frames": "told the order", **told})
        for variant, added in variants.items():
            product = learned(robot, added, shown)
            movements = [reproduced(product, objects) for objects in progress(new, f"{case}, {variant}")]
            found = measured(robot, movements, contested)
            table.append({"case": case, "frames": variant, **found})
            if variant in BOUNDS:
                rows += claims(case, variant, found, told)
                row, name = (1, PAPER) if variant == PAPER else (2, "all that is added")
                draw(panels[row, column], robot, movements[0], f"{case}: {name}, new paths")
    write_report("figure6_errors", table, options.output)
    return finish("figure6", figure, rows, options.output)


if __name__ == "__main__":
    sys.exit(main())
