# SPDX-License-Identifier: Apache-2.0
"""From the four sequences to the report's figures and its verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tpgmm_core import TPGMM
from tpgmm_core.common.report import format_table
from tpgmm_core.common.types import Array
from tpgmm_core.kinematics.hand_tasks import HandTask
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.figure5.measures import Measures, energy, measure
from tpgmm_demos.figure5.sequences import CUP, HELD, MOVE, SUGAR, Pushed, SequenceResult
from tpgmm_demos.figure5.session import SAMPLE_RATE
from tpgmm_ros.nodes.joint_reference import hand_task
from tpgmm_ros.task.task_file import Task

#: Turning by 1 rad counts as moving by this, m, where the two are compared.
LENGTH = 0.3
#: The states of the hands' poses that the lessons were about, and the frame in which they are held: known to the
#: judge alone.
TAUGHT = {CUP: ("world", (3, 4)), SUGAR: ("left_hand", (0, 1, 2))}

PRECISION_RATIO = 100.0
TILT_MEDIAN, TILT_WORST = 2.0, 5.0  # deg
PLACE_STEADY, PLACE_WORST = 0.02, 0.04  # m
MOVED = 0.10, 0.30  # m
SOFTNESS = 0.1
ELBOW_MOVED, ELBOW_PLACE, ELBOW_TILT = 0.05, 0.01, 2.0  # m, m, deg
COMBINED = 1.2
#: The energy after a push may rise by this share of what it was, for a moment.
ENERGY_RISE = 0.02
#: What is left of it after `AFTER`, at most, by what was pushed: tasks pull a hand back, while nothing but the weak
#: rest posture pulls an elbow, against friction.
ENERGY_LEFT = {"hand": 0.3, "elbow": 0.8}
#: So much of what springs hold ever becomes kinetic energy, at most, where each mode has the damping ratio 1 / sqrt(2)
#: and starts from rest: ((e^-x sin x) sqrt(2))^2 at x = pi / 4. Without damping it would be all of it.
KINETIC = float(np.exp(-np.pi / 2.0))
#: Of a hold, and of what comes after a push, the end counts as the steady state, s.
STEADY = 0.2
#: What 5 cm would take, m.
WAY = 0.05


def evaluate(
    robot: RobotModel, tasks: Mapping[str, Task], models: Mapping[str, TPGMM], courses: Sequence[SequenceResult]
) -> dict[str, Any]:
    """The report of one run: figures, and which of them are as they are to be.

    Parameters
    ----------
    robot
        that was simulated
    tasks
        by name
    models
        of the tasks, by name
    courses
        results of the sequences

    Returns
    -------
    dict[str, Any]
        what report.json holds
    """
    hands = {name: hand_task(task, models[name], list(robot.endpoints)) for name, task in tasks.items()}
    report: dict[str, Any] = {"frames": {name: judged_frames(name, model) for name, model in models.items()}}
    report["sequences"] = {course.sequence.name: _course(robot, hands, course) for course in courses}
    report["softness"] = _softness(robot, courses[-1])
    sequences = report["sequences"]
    cup, follow, both = (sequences[name] for name in ("cup", "follow", "both"))
    alone = {"tilt": (cup, "cup", "tilt_deg"), "place": (follow, "follow", "place_steady_m")}
    report["combined_over_alone"] = {
        name: both["repeated"][which][figure]["median"] / row["hand"][figure]["median"]
        for name, (row, which, figure) in alone.items()
    }
    report["combined_over_alone_same_way"] = {
        name: both["hand"][figure]["median"] / row["hand"][figure]["median"] for name, (row, _, figure) in alone.items()
    }
    everything = sequences.values()
    ways = [row["hand"]["moved_m"] for row in (cup, follow, both)]
    checks = {
        "the relevant frames are found": all(f["relevant_frame_stands_out"] for f in report["frames"].values()),
        "taught directions are 100 times as precise": all(
            f["precision_ratio"] >= PRECISION_RATIO for f in report["frames"].values()
        ),
        "hands were moved by 10 to 30 cm": all(MOVED[0] <= way["least"] and way["worst"] <= MOVED[1] for way in ways),
        "the cup stays level, alone": _level(cup["hand"]["tilt_deg"]),
        "the cup stays level, both tasks": _level(both["hand"]["tilt_deg"]),
        "the sugar stays in its place, alone": _in_place(sequences["sugar"]["elbow"]) and _in_place(follow["hand"]),
        "the sugar stays in its place, both tasks": _in_place(both["hand"]),
        "soft where the tasks leave freedom": report["softness"]["ratio"] <= SOFTNESS,
        "elbows give way, the tasks do not": _elbow(both["elbow"]),
        "both are as accurate as each alone": max(report["combined_over_alone"].values()) <= COMBINED,
        "torques within their limits": all(row["max_torque_share"] <= 1.0 for row in everything),
        "no joint at its limit": all(row["least_stop_distance_rad"] > 0.0 for row in everything),
        "energy falls after each push": all(row["energy_falls"] for row in everything),
    }
    return {"passed": all(checks.values()), "checks": checks, **report}


def _level(tilt: dict[str, float]) -> bool:
    return tilt["median"] <= TILT_MEDIAN and tilt["worst"] <= TILT_WORST


def _in_place(row: dict[str, Any]) -> bool:
    return row["place_steady_m"]["worst"] <= PLACE_STEADY and row["place_m"]["worst"] <= PLACE_WORST


def _elbow(row: dict[str, Any]) -> bool:
    return (
        row["moved_m"]["least"] >= ELBOW_MOVED
        and row["place_m"]["worst"] <= ELBOW_PLACE
        and row["tilt_deg"]["worst"] <= ELBOW_TILT
    )


def judged_frames(task: str, model: TPGMM) -> dict[str, Any]:
    """What each frame of a task found, in units of the frame's directions: m, and rad times `LENGTH`."""
    relevant, taught = TAUGHT[task]
    scale = np.repeat([1.0, LENGTH], 3)
    covariances = {name: model.covariances_[name][0] * np.outer(scale, scale) for name in model.frame_names_}
    firmest = {name: 1.0 / float(np.linalg.eigvalsh(C)[0]) for name, C in covariances.items()}
    C = covariances[relevant]
    free = np.setdiff1d(np.arange(6), taught)
    held_variance = np.linalg.eigvalsh(C[np.ix_(taught, taught)])[-1]
    free_variance = np.linalg.eigvalsh(C[np.ix_(free, free)])[0]
    # frames that stand where the relevant one does see what it sees
    twins = [name for name in firmest if np.allclose(covariances[name], C)]
    others = [value for name, value in firmest.items() if name not in twins]
    return {
        "deviations_m": {name: np.sqrt(np.linalg.eigvalsh(C)).tolist() for name, C in covariances.items()},
        "largest_precision": firmest,
        "relevant": twins,
        "relevant_frame_stands_out": firmest[relevant] >= PRECISION_RATIO * max(others),
        "precision_ratio": float(free_variance / held_variance),
    }


def _course(robot: RobotModel, hands: Mapping[str, HandTask], course: SequenceResult) -> dict[str, Any]:
    """Figures of one sequence: of the pushes of each kind, and of all."""
    holding = {name: hands[name] for name in course.sequence.tasks}
    result: dict[str, Any] = {"title": course.sequence.title, "tasks": list(course.sequence.tasks)}
    for kind in course.sequence.kinds:
        result[kind] = _figures(robot, [pushed for pushed in course.pushes if pushed.push.kind == kind])
    result["repeated"] = {name: _figures(robot, pushes) for name, pushes in course.repeated.items()}
    energies = [energy_after(robot, holding, pushed, course.rest) for pushed in course.all_pushes]
    result["energy_falls"] = all(
        energy.falls(pushed.push.kind) for pushed, energy in zip(course.all_pushes, energies, strict=True)
    )
    segments = [pushed.segment for pushed in course.all_pushes]
    result |= {f"energy_{name}": _spread([getattr(e, name) for e in energies]) for name in EnergyAfter._fields}
    result["max_torque_share"] = max(segment.torque_share for segment in segments)
    arms = np.concatenate([robot.indices(endpoint.joints) for endpoint in robot.endpoints.values()])
    result["least_stop_distance_rad"] = float(min(segment.stop_distance[arms].min() for segment in segments))
    return result


def _figures(robot: RobotModel, pushes: Sequence[Pushed]) -> dict[str, Any]:
    """Figures of some pushes of the same kind."""
    measured = [measure(robot, pushed.segment, pushed.link) for pushed in pushes]
    return {
        "moved_m": _spread([float(m.moved.max()) for m in measured]),
        "force_n": _spread([float(pushed.segment.force.max()) for pushed in pushes]),
        "tilt_deg": _spread([float(m.tilt.max()) for m in measured]),
        "place_m": _spread([float(m.offset.max()) for m in measured]),
        "place_steady_m": _spread([_steady(p, m) for p, m in zip(pushes, measured, strict=True)]),
    }


class EnergyAfter(NamedTuple):
    """Energy after a push, as shares of what it was when the push ended.

    Parameters
    ----------
    rise
        how far it ever rises above its lowest value so far
    left
        what is left of it in the end
    kinetic
        the largest kinetic energy
    """

    rise: float
    left: float
    kinetic: float

    def falls(self, kind: str) -> bool:
        """Whether it falls, far enough after a push of this kind, and damped as the law says."""
        return self.rise <= ENERGY_RISE and self.left <= ENERGY_LEFT[kind] and self.kinetic <= KINETIC


def energy_after(robot: RobotModel, holding: Mapping[str, HandTask], pushed: Pushed, rest: Array) -> EnergyAfter:
    """How energy goes after a push.

    Parameters
    ----------
    robot
        that was simulated
    holding
        tasks that hold, by name
    pushed
        the push
    rest
        shape (nv,), posture of the joints

    Returns
    -------
    EnergyAfter
        as shares of the energy when the push ended
    """
    parts = energy(robot, holding, _after(pushed), rest)
    after = parts.sum(axis=1)
    lowest = np.minimum.accumulate(after)
    shares = (after - lowest).max(), after[-1], parts[:, 0].max()
    return EnergyAfter(*(float(share / after[0]) for share in shares))


def _after(pushed: Pushed) -> Any:
    """The samples after the push."""
    segment = pushed.segment
    first = int(np.searchsorted(segment.time, MOVE + HELD + 0.5 / 100.0)) + 1
    return type(segment)(segment.times[first:], segment.states[first:], segment.forces[first:])


def _steady(pushed: Pushed, measures: Measures) -> float:
    """Where the sugar is from its place, m, while the hand is held away and when it has come back: the larger one."""
    time = pushed.segment.time
    held = (time >= MOVE + HELD - STEADY) & (time < MOVE + HELD)
    back = time >= time[-1] - STEADY
    return float(max(measures.offset[held].mean(), measures.offset[back].mean()))


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {"least": float(min(values)), "median": float(np.median(values)), "worst": float(max(values))}


def _softness(robot: RobotModel, course: SequenceResult) -> dict[str, Any]:
    """Forces for 5 cm, N: free directions beside constrained ones.

    In proportion to what small forces did at rest: 5 cm in a constrained direction are beyond the motors.
    """
    forces: dict[str, float] = {}
    for probed in course.probes:
        m = measure(robot, probed.segment, probed.link)
        kind, axis = probed.name.split("_")
        i = "xyz".index(axis)
        if kind == "move":
            forces[probed.name] = probed.size * WAY / _moved(m.left[:, i])
        elif kind == "apart":
            forces[probed.name] = probed.size * WAY / _moved(m.right[:, i] - m.left[:, i])
        else:
            # a torque is the force at the end of a lever
            forces[probed.name] = probed.size / LENGTH * WAY / (LENGTH * _moved(m.turned[:, i]))
    free = {name: force for name, force in forces.items() if name.startswith("move") or name == "turn_z"}
    held = {name: force for name, force in forces.items() if name not in free}
    ratio = max(
        max(free[f"move_{axis}"] for axis in "xyz") / min(held[f"apart_{axis}"] for axis in "xyz"),
        free["turn_z"] / min(held["turn_x"], held["turn_y"]),
    )
    return {"free_n_per_5cm": free, "constrained_n_per_5cm": held, "ratio": ratio}


def _moved(values: Array) -> float:
    """From the first sample to the mean of the last ones."""
    return float(abs(values[-round(STEADY * SAMPLE_RATE) :].mean() - values[0]))


def table(report: dict[str, Any]) -> str:
    """The report for people."""
    rows: list[tuple[str, str, str, str]] = []
    for name, frames in report["frames"].items():
        rows.append((f"{name}: precision, taught over free", f"{frames['precision_ratio']:.0f}", "", ">= 100"))
    for name, sequence in report["sequences"].items():
        for kind in ("hand", "elbow"):
            if kind not in sequence:
                continue
            row, told = sequence[kind], f"{name}, {kind} pushed"
            rows.append((f"{told}: moved by", *_told(row["moved_m"], 100.0, "cm"), ""))
            if CUP in sequence["tasks"]:
                to_reach = f"<= {TILT_MEDIAN:g}, {TILT_WORST:g} deg" if kind == "hand" else f"<= {ELBOW_TILT:g} deg"
                rows.append((f"{told}: tilt of the cup", *_told(row["tilt_deg"], 1.0, "deg"), to_reach))
            if SUGAR in sequence["tasks"]:
                steady = f"<= {100 * PLACE_STEADY:g} cm"
                worst = f"<= {100 * (PLACE_WORST if kind == 'hand' else ELBOW_PLACE):g} cm"
                rows.append((f"{told}: sugar, steady", *_told(row["place_steady_m"], 100.0, "cm"), steady))
                rows.append((f"{told}: sugar, on the way", *_told(row["place_m"], 100.0, "cm"), worst))
    rows.append(("softness, free over constrained", f"{report['softness']['ratio']:.3f}", "", f"<= {SOFTNESS:g}"))
    for name, ratio in report["combined_over_alone"].items():
        rows.append((f"both tasks over one alone: {name}", f"{ratio:.2f}", "", f"<= {COMBINED:g}"))
    rows += [(what, "yes" if ok else "NO", "", "yes") for what, ok in report["checks"].items()]
    rows.append(("passed", "yes" if report["passed"] else "NO", "", "yes"))
    return format_table(("what", "median", "worst", "to reach"), rows)


def _told(spread: dict[str, float], factor: float, unit: str) -> tuple[str, str]:
    return f"{factor * spread['median']:.2f} {unit}", f"{factor * spread['worst']:.2f} {unit}"
