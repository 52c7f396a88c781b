# SPDX-License-Identifier: Apache-2.0
"""From what was recorded to the demo's figures and its verdict."""

from __future__ import annotations

import math
import os
import textwrap
from typing import Any

import numpy as np

from tpgmm_core.common.report import format_table
from tpgmm_core.geometry.pose import pose_error
from tpgmm_demos.demo.causes import cause_of_failure
from tpgmm_demos.demo.recording import RunRecord, Series
from tpgmm_demos.demo.world import World

NODES = ("reproduction", "impedance_controller", "baxter_simulator")

#: What has to be reached: m, deg, shares of the effort limits. A jump of up to JUMP, N m beyond the slope before
#: it, passes; so does one that the movement makes elsewhere too.
LARGEST_POSITION_ERROR = 0.01
LARGEST_ORIENTATION_ERROR = 5.0
LARGEST_TORQUE_SHARE = 1.0
JUMP = 0.5
#: A motor that gives this share of what it can give counts as one at its limit.
SATURATED = 0.999
#: A frame that came back is watched for this long, s; what is usual elsewhere is judged in pieces as long.
AFTERWARDS = 0.5
#: A controller that sends nothing for longer than this is silent, s.
SILENCE = 0.25
#: s from one command to the next.
TICK = 0.001
#: Ticks that tell how a torque was changing before a tick.
BEFORE = 10


def evaluate(
    recording: RunRecord, world: World, effort_limits: np.ndarray, outcome: tuple[bool, str], lockstep: bool
) -> dict[str, Any]:
    """The report of one run.

    Parameters
    ----------
    recording
        what was on the topics
    world
        where things are at the end
    effort_limits
        (nv,), N m
    outcome
        what the action said
    lockstep
        no tick was late, so that a jump has no excuse

    Returns
    -------
    dict[str, Any]
        what report.json holds
    """
    assert world.started_ns is not None
    position, angle = pose_error(world.grasp.object, world.situation.target)
    orientation = math.degrees(angle)
    torque = recording.torque().since(world.started_ns)
    hidden = world.disturbances.hide_start, world.disturbances.hide_start + world.disturbances.hide_duration
    lost = largest_jump(torque, world.started_ns, *hidden)
    back = largest_jump(torque, world.started_ns, hidden[1], hidden[1] + AFTERWARDS)
    usual = JUMP if lockstep else max(JUMP, usual_jump(torque, world.started_ns, hidden))
    silence = longest_silence(torque, world.started_ns, hidden[1] + AFTERWARDS)
    share = float((np.abs(torque.values) / effort_limits).max())
    checks = {
        "the object was grasped": world.grasp.holds,
        "the movement ended well": outcome[0],
        "the object is on the target": position <= LARGEST_POSITION_ERROR,
        "the object is turned as the target": orientation <= LARGEST_ORIENTATION_ERROR,
        "no torque above its limit": share <= LARGEST_TORQUE_SHARE,
        "torques arrived without a gap": silence <= SILENCE,
        "no jump when a frame was lost": lost is not None and lost <= usual,
        "no jump when it came back": back is not None and back <= usual,
    }
    diagnostics = {node: recording.diagnostics(node, world.started_ns) for node in NODES}
    simulator = diagnostics["baxter_simulator"][-1]
    reproduction = diagnostics["reproduction"][-1]
    at_limit = (np.abs(torque.values) >= SATURATED * effort_limits).any(axis=0)
    report = {
        "passed": all(checks.values()),
        "final_position_error_m": position,
        "final_orientation_error_deg": orientation,
        "path_deviation_m": _path_deviation(recording, world.started_ns),
        "max_torque_share": share,
        "torque_jump_when_frame_lost_nm": lost,
        "torque_jump_when_frame_back_nm": back,
        "usual_torque_jump_nm": usual,
        "largest_torque_jump_nm": largest_jump(torque, world.started_ns, 0.0, math.inf),
        "longest_silence_s": silence,
        "ticks": {node: _ticks(rows) for node, rows in diagnostics.items()},
        "reproduction_step_ms": {name: float(reproduction[f"step_{name}_ms"]) for name in ("p50", "p99")},
        "torque_age_ms": {name: float(simulator[f"age_{name}_ms"]) for name in ("p50", "p99")},
        "reference_speed_m_s": _reference_speed(recording, world.started_ns, hidden[0], hidden[1] + AFTERWARDS),
        "movement_time_s": float(torque.times(world.started_ns)[-1]),
        "outcome": outcome[1],
        "checks": checks,
        "lockstep": lockstep,
        "perception": _perception(recording, world),
        "nearest_to_grasp": {"m": float(world.nearest[0]), "rad": float(world.nearest[1])},
        "saturated_joints": [name for name, full in zip(recording.joints, at_limit, strict=True) if full],
        "load": os.getloadavg()[0],
        "cores": os.cpu_count() or 1,
    }
    return report | {"cause": cause_of_failure(report)}


def _perception(recording: RunRecord, world: World) -> dict[str, Any]:
    """What of the camera's images came through to the task parameters, per second in which the object was in sight."""
    assert world.started_ns is not None
    counts = recording.observations(world.started_ns)
    in_sight_s = world.in_sight_s(world.started_ns)
    rates = {name: counts[name] / time for name, time in in_sight_s.items() if time > 0.0}
    return {"camera_hz": world.camera.config.rate, "rate_hz": rates}


def usual_jump(torque: Series, origin_ns: int, hidden: tuple[float, float]) -> float:
    """Largest step, N m, while nothing was lost: where ticks come late, the movement itself makes larger ones.

    The largest but one of all pieces of `AFTERWARDS`: one jump elsewhere does not excuse another.

    Parameters
    ----------
    torque
        of the whole movement
    origin_ns
        its start, ns
    hidden
        since when and until when a frame was not seen, s since the start

    Returns
    -------
    float
        N m; 0 where fewer than two pieces have torques
    """
    last = float(torque.times(origin_ns)[-1]) if len(torque.stamps_ns) else 0.0
    pieces = [
        *np.arange(0.0, hidden[0] - AFTERWARDS, AFTERWARDS),
        *np.arange(hidden[1] + AFTERWARDS, last, AFTERWARDS),
    ]
    steps = [largest_jump(torque, origin_ns, float(start), float(start) + AFTERWARDS) for start in pieces]
    known = sorted(step for step in steps if step is not None)
    return known[-2] if len(known) > 1 else 0.0


def largest_jump(torque: Series, origin_ns: int, start: float, end: float) -> float | None:
    """Largest change of any joint's torque from one tick to the next between two times, beyond its slope before.

    The slope is the median change of the `BEFORE` ticks before: a fast movement is no jump. Where the machine was late
    and commands are missing, their change is shared out over the ticks they cover.

    Parameters
    ----------
    torque
        of the whole movement
    origin_ns
        its start, ns
    start, end
        s since the start

    Returns
    -------
    float | None
        N m; None where fewer than two torques came, which shows nothing
    """
    times = torque.times(origin_ns)
    chosen = (times >= start) & (times <= end)
    if chosen.sum() < 2:
        return None
    ticks = np.maximum(1.0, np.rint(np.diff(times) / TICK))
    change = np.diff(torque.values, axis=0) / ticks[:, None]
    known = np.concatenate([np.repeat(change[:1], BEFORE, axis=0), change[:-1]])
    slope = np.median(np.lib.stride_tricks.sliding_window_view(known, BEFORE, axis=0), axis=-1)
    return float(np.abs(change - slope)[chosen[1:] & chosen[:-1]].max())


def longest_silence(torque: Series, origin_ns: int, end: float) -> float:
    """Longest time without a torque.

    Parameters
    ----------
    torque
        of the whole movement
    origin_ns
        its start, ns
    end
        until then, s since the start

    Returns
    -------
    float
        s
    """
    times = torque.times(origin_ns)
    inside = times[(times > 0.0) & (times < end)]
    return float(np.diff(np.concatenate([[0.0], inside, [end]])).max())


def _path_deviation(recording: RunRecord, origin_ns: int) -> float:
    """Root mean square distance between the hand and the reference's mean at the same stamp, m."""
    reference = recording.reference().since(origin_ns)
    hand = recording.hand().since(origin_ns)
    at = np.minimum(np.searchsorted(reference.stamps_ns, hand.stamps_ns), len(reference.stamps_ns) - 1)
    distance = np.linalg.norm(hand.values[:, :3] - reference.values[at, :3], axis=1)
    return float(np.sqrt(np.mean(distance**2)))


def _reference_speed(recording: RunRecord, origin_ns: int, start: float, end: float) -> dict[str, float]:
    """Largest speed of the reference between two times, when that was, and its mean over the movement, m/s and s."""
    reference = recording.reference().since(origin_ns)
    times = reference.times(origin_ns)
    step, way = np.diff(times), np.linalg.norm(np.diff(reference.values[:, :3], axis=0), axis=1)
    inside = (step > 0.0) & (times[1:] >= start) & (times[1:] <= end)
    if not inside.any():
        return {"largest": 0.0, "at_s": start, "mean": 0.0}
    speeds = way[inside] / step[inside]
    fastest = int(np.argmax(speeds))
    mean = float(way.sum() / (times[-1] - times[0]))
    return {"largest": float(speeds[fastest]), "at_s": float(times[1:][inside][fastest]), "mean": mean}


def _ticks(rows: list[dict[str, str]]) -> dict[str, int]:
    """Ticks asked for and done between the first and the last of a node's diagnostics."""
    ticks = {}
    for name in ("asked", "done"):
        counts = [int(row[f"ticks_{name}"]) for row in rows]
        ticks[name] = counts[-1] - counts[0] if len(counts) > 1 else counts[-1]
    return ticks


def table(report: dict[str, Any]) -> str:
    """The report for people."""
    usual = f"<= {report['usual_torque_jump_nm']:.3f} N m"
    rows: list[tuple[str, str, str]] = [
        (
            "final position error",
            f"{1e3 * report['final_position_error_m']:.2f} mm",
            f"<= {1e3 * LARGEST_POSITION_ERROR:g} mm",
        ),
        (
            "final orientation error",
            f"{report['final_orientation_error_deg']:.2f} deg",
            f"<= {LARGEST_ORIENTATION_ERROR:g} deg",
        ),
        ("path deviation (RMS)", f"{1e3 * report['path_deviation_m']:.2f} mm", ""),
        ("largest torque, share of its limit", f"{report['max_torque_share']:.3f}", f"<= {LARGEST_TORQUE_SHARE:g}"),
        ("torque jump, frame lost", _newton_metres(report["torque_jump_when_frame_lost_nm"]), usual),
        ("torque jump, frame back", _newton_metres(report["torque_jump_when_frame_back_nm"]), usual),
        ("largest torque jump", _newton_metres(report["largest_torque_jump_nm"]), ""),
        ("longest time without a torque", f"{report['longest_silence_s']:.3f} s", f"<= {SILENCE:g} s"),
    ]
    for node, ticks in report["ticks"].items():
        share = 100.0 * ticks["done"] / max(1, ticks["asked"])
        rows.append((f"ticks, {node}", f"{ticks['done']} of {ticks['asked']} ({share:.1f} %)", ""))
    for key, name in (("reproduction_step_ms", "reproduction step"), ("torque_age_ms", "torque age")):
        values = report[key]
        rows.append((name, f"p50 {values['p50']:.2f} ms, p99 {values['p99']:.2f} ms", ""))
    perception = report["perception"]
    for frame, rate in perception["rate_hz"].items():
        rows.append((f"poses of '{frame}' that arrived", f"{rate:.1f} of {perception['camera_hz']:.1f} per s", ""))
    rows += [(what, "yes" if ok else "NO", "yes") for what, ok in report["checks"].items()]
    rows.append(("passed", "yes" if report["passed"] else "NO", "yes"))
    text = format_table(("what", "measured", "to reach"), rows)
    return f"{text}\n{textwrap.fill('cause: ' + report['cause'], 120)}" if report["cause"] else text


def _newton_metres(step: float | None) -> str:
    return "no torques" if step is None else f"{step:.3f} N m"
