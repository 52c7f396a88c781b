# SPDX-License-Identifier: Apache-2.0
"""Figure 6 of the paper: priorities of a bimanual planar robot, learned from demonstrations.

Two objects move, one for each hand. For some of the time both cannot be reached. In the demonstrations the robot then
makes a compromise, or gives priority to the left hand, or to the right one. The candidate frames are the same each
time: each hand's object for itself, below the other one, and both together. What was meant is found in the
demonstrations, and judged on new paths of the objects, beside a controller by hand (null-space projections) that is
told the order.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from examples.report import progress, write_report  # noqa: E402
from tpgmm_core import TPGMM, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.kinematics.chains import PlanarRobot, planar_bimanual  # noqa: E402
from tpgmm_core.kinematics.frames import PreviousConfiguration  # noqa: E402
from tpgmm_core.kinematics.hierarchy import hierarchy_frames  # noqa: E402
from tpgmm_core.kinematics.inverse import damped_pseudo_inverse, null_space  # noqa: E402
from tpgmm_core.kinematics.moving import ConfigurationProduct, MovingFrames  # noqa: E402
from tpgmm_core.kinematics.object_targets import target_object_origins  # noqa: E402
from tpgmm_core.kinematics.tasks import KinematicTask  # noqa: E402

HANDS = ("left", "right")
HIERARCHIES: dict[str, list[str | list[str]]] = {
    "left before right": ["left", "right"],
    "right before left": ["right", "left"],
    "together": [["left", "right"]],
}
#: Case → how much each hand's squared error counts in the demonstrations; the order that the controller by hand is told
CASES: dict[str, tuple[tuple[float, float], list[tuple[str, ...]]]] = {
    "compromise": ((1.0, 1.0), [("left", "right")]),
    "left first": ((1.0, 1e-4), [("left",), ("right",)]),
    "right first": ((1e-4, 1.0), [("right",), ("left",)]),
}
START = np.array([0.0, 1.2, -1.6, -1.2, 1.6])
MIRRORED = [0, 3, 4, 1, 2]  # joints of the robot in the mirror, where all angles change their sign
STEPS, DURATION = 200, 8.0  # samples of a path, and s
SUBSTEPS = 10  # of the reproduction for each sample of a path: at 250 Hz
THRESHOLD = 0.2  # of the damping, m/rad
TREMOR = 0.01  # m
OUT_OF_REACH = 0.05  # m that the better compromise leaves to one of the objects
SHOWN_SHARE = 0.2  # of each demonstration in which both objects are out of reach, at least


@dataclass(frozen=True, slots=True)
class Movement:
    """Paths of the objects, name of the hand → (T, 2), m, and configurations (T, 5), rad."""

    objects: Mapping[str, Array]
    q: Array


def wandering(rng: np.random.Generator, size: float, frequencies: int) -> Array:
    """A smooth path (T, 2) from zero to zero, m."""
    u = np.linspace(0.0, 1.0, STEPS)
    waves = np.stack([np.sin(np.pi * k * u) / k for k in range(1, frequencies + 1)], axis=1)
    return size * waves @ rng.normal(size=(frequencies, 2))


def object_paths(robot: PlanarRobot, rng: np.random.Generator) -> dict[str, Array]:
    """From the hands outward and back, each within the reach of its hand, but not always both at once."""
    u = np.linspace(0.0, 1.0, STEPS)[:, None]
    out = np.sin(np.pi * np.clip((u - 0.1) / 0.8, 0.0, 1.0)) ** 2
    robot.update(START)
    paths = {}
    for hand, side in (("left", -1.0), ("right", 1.0)):
        radius, angle = rng.uniform(2.4, 2.85), rng.uniform(0.05, 0.35) * np.pi
        angles = angle + rng.uniform(-0.15, 0.15) * np.pi * (2.0 * u - 1.0)
        far = radius * np.hstack([side * np.cos(angles), np.sin(angles)])
        paths[hand] = robot.place(hand) + out * (far - robot.place(hand)) + wandering(rng, 0.05, 3)
    return paths


def best_compromise(robot: PlanarRobot, q: Array, targets: Mapping[str, Array], weights: Sequence[float]) -> Array:
    """The configuration (5,) with the least weighted squared errors near q, by Levenberg and Marquardt's steps."""
    roots = np.sqrt(np.repeat(weights, 2))

    def residual(q: Array) -> Array:
        robot.update(q)
        return roots * np.concatenate([targets[hand] - robot.place(hand) for hand in HANDS])

    e = residual(q)
    for _ in range(20):
        robot.update(q)
        J = roots[:, None] * np.concatenate([robot.jacobian(hand) for hand in HANDS])
        damping = 1e-3
        while damping < 1e3:
            step = np.linalg.solve(J.T @ J + damping * np.eye(5), J.T @ e)
            ahead = residual(q + step)
            if ahead @ ahead <= e @ e:
                break
            damping *= 4.0
        else:
            return q
        q, e = q + step, ahead
        if np.abs(step).max() < 1e-6:
            break
    return q


def best(robot: PlanarRobot, targets: Mapping[str, Array], weights: Sequence[float]) -> Array:
    """`best_compromise` along paths of the targets, (T, 5)."""
    configurations = [START]
    for t in range(STEPS):
        now = {hand: path[t] for hand, path in targets.items()}
        configurations.append(best_compromise(robot, configurations[-1], now, weights))
    return np.stack(configurations[1:])


def out_of_reach(robot: PlanarRobot, objects: Mapping[str, Array]) -> NDArray[np.bool_]:
    """When both objects cannot be reached at once, (T,)."""
    compromise = Movement(objects, best(robot, objects, (1.0, 1.0)))
    return np.asarray(errors(robot, compromise).max(axis=1) > OUT_OF_REACH)


def demonstration(robot: PlanarRobot, weights: Sequence[float], rng: np.random.Generator) -> Movement:
    """What somebody shows whose hands tremble a little, on paths that leave a choice for long enough to show it."""
    objects = object_paths(robot, rng)
    while out_of_reach(robot, objects).mean() < SHOWN_SHARE:
        objects = object_paths(robot, rng)
    aims = {hand: path + wandering(rng, TREMOR, 8) for hand, path in objects.items()}
    return Movement(objects, best(robot, aims, weights))


def mirrored(movement: Movement) -> Movement:
    """The same with left and right exchanged."""
    objects = {"left": movement.objects["right"], "right": movement.objects["left"]}
    return Movement({hand: path * [-1.0, 1.0] for hand, path in objects.items()}, -movement.q[:, MIRRORED])


def as_frames(places: Mapping[str, Array]) -> dict[str, Frame]:
    """Objects that do not turn, from positions (2,) or (T, 2)."""
    return {f"{hand} object": Frame(np.eye(2), place) for hand, place in places.items()}


def learned(frames: MovingFrames, movements: Sequence[Movement]) -> TPGMM:
    """One Gaussian in each frame, about the objects."""
    times = np.linspace(0.0, DURATION, STEPS)
    model = TPGMM(1, reg_covar=1e-6).fit([frames.demonstration(times, m.q, as_frames(m.objects)) for m in movements])
    target_object_origins(model, model.frame_names_)
    return model


def reproduced(product: ConfigurationProduct, objects: Mapping[str, Array]) -> Movement:
    """The model on new paths: the objects stand still for some steps of the product."""
    q, configurations = START, []
    for t in range(STEPS):
        now = as_frames({hand: path[t] for hand, path in objects.items()})
        for _ in range(SUBSTEPS):
            q = product.step(q, now, dt=DURATION / (STEPS * SUBSTEPS)).mean
        configurations.append(q)
    return Movement(objects, np.stack(configurations))


def by_hand(robot: PlanarRobot, levels: Sequence[tuple[str, ...]], objects: Mapping[str, Array]) -> Movement:
    """Inverse kinematics, level by level in the null space of those above (Siciliano and Slotine 1991)."""
    q, configurations = START, []
    for t in range(STEPS):
        for _ in range(SUBSTEPS):
            robot.update(q)
            step, N, above = np.zeros(5), np.eye(5), np.zeros((0, 5))
            for level in levels:
                J = np.concatenate([robot.jacobian(hand) for hand in level])
                e = np.concatenate([objects[hand][t] - robot.place(hand) for hand in level])
                part = damped_pseudo_inverse(J @ N, THRESHOLD) @ (e - J @ step)
                step = step + part * min(1.0, 0.1 / max(float(np.linalg.norm(part)), 1e-9))  # at most 0.1 rad
                above = np.concatenate([above, J])
                N = null_space(above, THRESHOLD)
            q = q + step
        configurations.append(q)
    return Movement(objects, np.stack(configurations))


def errors(robot: PlanarRobot, movement: Movement) -> Array:
    """Distances (T, 2) of the left and the right hand from their objects, m."""
    result = np.empty((STEPS, 2))
    for t, q in enumerate(movement.q):
        robot.update(q)
        result[t] = [np.linalg.norm(movement.objects[hand][t] - robot.place(hand)) for hand in HANDS]
    return result


def judged(case: str, shown: str, learned_: Array, told: Array, share: float) -> Row:
    """One row: mean errors (2,) in the phases where both objects cannot be reached, of the model and the controller."""
    first, second = sorted(learned_) if case == "compromise" else learned_[[HANDS.index(h) for h in _order(case)]]
    ratio = float(second / first)
    difference = float(learned_.sum() / told.sum() - 1.0)
    met = ratio <= 1.5 if case == "compromise" else ratio >= 5.0
    return {
        "case": case,
        "demonstrations": shown,
        "left_error_m": float(learned_[0]),
        "right_error_m": float(learned_[1]),
        "ratio": ratio,
        "told_left_error_m": float(told[0]),
        "told_right_error_m": float(told[1]),
        "difference": difference,
        "share_out_of_reach": share,
        "passed": bool(met and abs(difference) <= 0.1),
    }


def _order(case: str) -> list[str]:
    return [hand for level in CASES[case][1] for hand in level]


def draw(axes: Axes, robot: PlanarRobot, movement: Movement) -> None:
    """The robot from light grey to black, the objects' paths in red."""
    for t in np.linspace(0, STEPS - 1, 9).astype(int):
        robot.update(movement.q[t])
        for hand in HANDS:
            axes.plot(*robot.way_to(hand).T, color=str(0.85 - 0.85 * t / STEPS), lw=1.5, solid_joinstyle="round")
    for path in movement.objects.values():
        axes.plot(*path.T, color="#c1121f", lw=1.5, zorder=5)
    axes.set(xlim=(-3.1, 3.1), ylim=(-0.3, 3.2), xticks=[], yticks=[], aspect="equal")


def draw_relevance(axes: Axes, model: TPGMM) -> None:
    """Standard deviation of what each candidate frame saw."""
    names = [name for name in model.frame_names_ if name != "previous"]
    deviations = [np.sqrt(np.trace(model.covariances_[n][0]) / len(model.means_[n][0])) for n in names]
    axes.barh(names, deviations, color="0.4")
    axes.set(xscale="log", xlim=(3e-3, 0.5), xlabel="standard deviation (m)")
    axes.invert_yaxis()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/figure6"), help="of report.json, figure6.png")
    parser.add_argument("--paths", type=int, default=50, help="new paths of the objects (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of demonstrations and paths (default: %(default)s)")
    options = parser.parse_args(arguments)
    robot = planar_bimanual()
    tasks = {hand: KinematicTask(hand, relative_to=f"{hand} object") for hand in HANDS}
    candidates = {**hierarchy_frames(tasks, HIERARCHIES), "previous": PreviousConfiguration()}
    frames = MovingFrames(robot, candidates, THRESHOLD)
    rng = np.random.default_rng(options.seed)
    shown = {
        case: [demonstration(robot, weights, rng) for _ in progress(range(3), f"demonstrations, {case}")]
        for case, (weights, _) in CASES.items()
    }

    new = [object_paths(robot, rng) for _ in range(options.paths)]
    masks = np.concatenate([out_of_reach(robot, objects) for objects in progress(new, "paths out of reach")])
    told = {}
    for case, (_, levels) in CASES.items():
        movements = [by_hand(robot, levels, objects) for objects in progress(new, f"controller by hand, {case}")]
        told[case] = np.concatenate([errors(robot, m) for m in movements])[masks].mean(axis=0)

    figure = Figure(figsize=(18.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    columns = figure.subfigures(1, 3, squeeze=False)[0]
    rows: list[Row] = []
    for column, case in zip(columns, CASES, strict=True):
        in_mirror = {"compromise": "compromise", "left first": "right first", "right first": "left first"}[case]
        parts = column.subfigures(3, 1, squeeze=False)[:, 0]
        for part, title in zip(parts, (f"{case}: demonstrations", "reproductions", "what the frames saw"), strict=True):
            part.suptitle(title)
        for i, (name, movements) in enumerate(
            (("as shown", shown[case]), ("in the mirror", [mirrored(m) for m in shown[case]]))
        ):
            model = learned(frames, movements)
            product = ConfigurationProduct(model, frames)
            reproductions = [reproduced(product, objects) for objects in progress(new, f"{case}, {name}")]
            mean = np.concatenate([errors(robot, m) for m in reproductions])[masks].mean(axis=0)
            meant = in_mirror if i else case
            rows.append(judged(meant, f"{case}, {name}", mean, told[meant], float(masks.mean())))
            if i == 0:
                for part, drawn in zip(parts, (movements, reproductions[:3]), strict=False):
                    for axes, movement in zip(part.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
                        draw(axes, robot, movement)
                draw_relevance(parts[2].subplots(), model)

    write_report("report", rows, options.output)
    figure.savefig(options.output / "figure6.png", dpi=70)
    print(f"picture: {options.output / 'figure6.png'}")
    return 0 if all(row["passed"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
