# SPDX-License-Identifier: Apache-2.0
"""Why a run of the demo failed, in words and with figures: first of all, whether the machine kept up."""

from __future__ import annotations

import math
from typing import Any

from tpgmm_demos.scene.pick_place import Grasp

#: Beyond these the machine was too slow. On an idle one with two cores a node loses some 0.5 % of its ticks, torques
#: answer to a state that is 2 ms old (p99), and all that the camera saw comes through.
MAX_LOST_SHARE = 0.01
MAX_TORQUE_AGE_MS = 5.0
MIN_PERCEPTION_SHARE = 0.8
#: A reference that is faster than its mean by this factor asks for torques that look like a jump.
FAST = 4.0
#: More programs than cores that want to run, above which a time-out is put down to the machine. The demo's own
#: nodes are among them: while they start, each wants a core.
MAX_WAITING_PROGRAMS = 1.0


def machine_figures(report: dict[str, Any]) -> list[str]:
    """In what the machine was too slow; empty if it kept up. In lockstep time waits, and it always does."""
    if report["lockstep"]:
        return []
    found = []
    for node, ticks in report["ticks"].items():
        lost = ticks["asked"] - ticks["done"]
        if not ticks["asked"]:
            found.append(f"{node} was too busy to report its ticks")
        elif lost > MAX_LOST_SHARE * ticks["asked"]:
            share = 100.0 * lost / ticks["asked"]
            found.append(
                f"{node} lost {lost} of {ticks['asked']} ticks ({share:.1f} %, {100 * MAX_LOST_SHARE:g} % tolerated)"
            )
    age = report["torque_age_ms"]["p99"]
    if age > MAX_TORQUE_AGE_MS:
        found.append(f"torques answered to states up to {age:.1f} ms old (p99, {MAX_TORQUE_AGE_MS:g} ms tolerated)")
    perception = report["perception"]
    for frame, rate in perception["rate_hz"].items():
        if rate < MIN_PERCEPTION_SHARE * perception["camera_hz"]:
            borne = MIN_PERCEPTION_SHARE * perception["camera_hz"]
            found.append(f"of '{frame}' {rate:.0f} poses per second arrived (at least {borne:.0f} needed)")
    return found


def cause_of_waiting_in_vain(load: float, cores: int, lockstep: bool) -> str:
    """The likely cause where nothing ended, but something did not come in time.

    Parameters
    ----------
    load
        programs that wanted to run, on average over the last minute
    cores
        that there are for them
    lockstep
        simulated time waits, and longer already

    Returns
    -------
    str
        empty if the machine had time for it
    """
    if load <= cores + MAX_WAITING_PROGRAMS:
        return ""
    remedy = "End other programs" if lockstep else "End other programs, or use --lockstep, which waits longer"
    return f"The machine was too slow: {load:.1f} programs were ready to run on {cores} cores. {remedy}."


def cause_of_failure(report: dict[str, Any]) -> str:
    """The likely cause, in words; empty where the run passed."""
    if report["passed"]:
        return ""
    causes = []
    if slow := machine_figures(report):
        busy = f"{report['load']:.1f} programs were ready to run on {report['cores']} cores"
        causes.append(
            f"the machine was too slow for real time ({busy}): {'; '.join(slow)}. End other programs, or use "
            "--lockstep, where simulated time waits for the slowest"
        )
    checks = report["checks"]
    if not checks["the object was grasped"]:
        came, turned = 1e3 * report["nearest_to_grasp"]["m"], math.degrees(report["nearest_to_grasp"]["rad"])
        near, straight = 1e3 * Grasp.TOLERANCE[0], math.degrees(Grasp.TOLERANCE[1])
        causes.append(
            f"the gripper never closed: the hand came as near as {came:.1f} mm and {turned:.1f} deg to the object; it "
            f"closes when the hand rests within {near:g} mm and {straight:.0f} deg for {Grasp.DWELL:g} s"
        )
    if not checks["the movement ended well"]:
        causes.append(f"the action ended with: {report['outcome']}")
    if report["saturated_joints"]:
        causes.append(f"motors at their limits: {', '.join(report['saturated_joints'])}")
    speed = report["reference_speed_m_s"]
    is_steady = checks["no jump when a frame was lost"] and checks["no jump when it came back"]
    if not is_steady and speed["largest"] > FAST * speed["mean"]:
        causes.append(
            f"the model itself moves fast there: its reference reached {speed['largest']:.2f} m/s after "
            f"{speed['at_s']:.1f} s, {speed['largest'] / speed['mean']:.0f} times its mean speed, as it "
            "goes from one component to the next: see path.png, or demonstrate a situation like this one"
        )
    if not causes:
        failed = ", ".join(f"'{what}'" for what, ok in checks.items() if not ok)
        causes.append(f"no fault of the machine was found; what failed is {failed}: see the pictures and the logs")
    return ". ".join(cause[0].upper() + cause[1:] for cause in causes) + "."
