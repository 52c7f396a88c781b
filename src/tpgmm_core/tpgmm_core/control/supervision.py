# SPDX-License-Identifier: Apache-2.0
"""What a controller does about the age and the validity of its inputs; time is an argument everywhere."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from tpgmm_core.common.settings import Settings, setting

#: With fewer joint states than this within `joint_state_timeout`, a late one counts as silence.
STATES_WITHIN_TIMEOUT = 3
#: Tolerance for the measured rate.
RATE_TOLERANCE = 0.05


class ControllerMode(enum.IntEnum):
    """Modes as in ``tpgmm_msgs/ControllerState``."""

    WAITING = 0  # no joint states: no torques
    ACTIVE = 1  # follows the reference
    HOLD = 2  # holds the last reference with its stiffness, or cannot get to it and is pulled a little only
    DAMPING = 3  # carries the robot's weight and damps its motion: no reference, or one that cannot be followed safely
    FAULT = 4  # joint states that cannot be used: as DAMPING at the last good one, then no torques


@dataclass(frozen=True, slots=True, kw_only=True)
class Timeouts(Settings):
    """When a joint state or a reference is too old, and which stamps are invalid."""

    joint_state_timeout: float = setting(
        0.02, 0.002, 10.0, "Longest pause between joint states before the robot is only damped, s"
    )
    silence_after: float = setting(
        0.2, 0.0, 10.0, "Time for which it is damped without joint states; then no more torques are sent, s"
    )
    reference_timeout: float = setting(
        0.1, 0.002, 10.0, "Age at which a reference is no longer followed, but held at rest, s"
    )
    hold_time: float = setting(1.0, 0.0, 600.0, "Time for which a reference is held; then the robot is only damped, s")
    max_age: float = setting(
        0.1,
        0.0,
        10.0,
        "Joint states with older stamps are refused, s; 0: never, for stamps of a clock that cannot be compared",
    )
    actuation_delay: float = setting(0.001, 0.0, 0.1, "Delay from sending torques to their effect at the motors, s")
    max_future: float = setting(0.05, 0.001, 10.0, "Messages with stamps further in the future are refused, s")


@dataclass(frozen=True, slots=True)
class Inputs:
    """What is known of the inputs at one time.

    Parameters
    ----------
    state_age
        s since the last good joint state; None: never one
    state_fault
        why the newest joint state was refused; empty when it was good
    reference_age
        s since the last good reference, by arrival or by stamp, whichever is more; None: never one
    reference_fault
        why the newest reference was refused; empty when it was good
    state_trouble
        what came instead of a joint state: joints that are missing, stamps that stand still
    """

    state_age: float | None
    state_fault: str
    reference_age: float | None
    reference_fault: str
    state_trouble: str = ""


@dataclass(frozen=True, slots=True)
class Decision:
    """A mode, the reason for it, and whether torques are sent in it."""

    mode: ControllerMode
    reason: str
    sends: bool


def decide(inputs: Inputs, timeouts: Timeouts) -> Decision:
    """Decide the mode for inputs of these ages. Joint states come first: without them nothing is known."""
    patience = timeouts.joint_state_timeout + timeouts.silence_after
    trouble = f" ({inputs.state_trouble})" if inputs.state_trouble else ""
    if inputs.state_fault:
        in_time = inputs.state_age is not None and inputs.state_age <= patience
        return Decision(ControllerMode.FAULT, f"joint state refused: {inputs.state_fault}", in_time)
    if inputs.state_age is None:
        return Decision(ControllerMode.WAITING, "no joint state yet" + trouble, False)
    if inputs.state_age > patience:
        return Decision(ControllerMode.WAITING, f"no new joint state for {patience:g} s: silent{trouble}", False)
    if inputs.state_age > timeouts.joint_state_timeout:
        words = (
            f"no new joint state for {timeouts.joint_state_timeout:g} s: gravity compensation at the last known "
            "position"
        )
        return Decision(ControllerMode.DAMPING, words + trouble, True)
    refused = f" (the newest was refused: {inputs.reference_fault})" if inputs.reference_fault else ""
    age = inputs.reference_age
    if age is None:
        return Decision(ControllerMode.DAMPING, "no reference yet" + refused, True)
    if age <= timeouts.reference_timeout:
        return Decision(ControllerMode.ACTIVE, "following the reference", True)
    held_until = timeouts.reference_timeout + timeouts.hold_time
    if age <= held_until:
        words = f"no reference for {timeouts.reference_timeout:g} s: holding the last one"
        return Decision(ControllerMode.HOLD, words + refused, True)
    return Decision(ControllerMode.DAMPING, f"no reference for {held_until:g} s: gravity compensation" + refused, True)


def slow_states(period: float, source: str, timeouts: Timeouts, max_time_step: float) -> list[str]:
    """What has to be set for joint states that come every `period` s, in words; nothing where all is well.

    The values are suggested, not set: only those who know the robot can say how long it may go on without being
    observed.

    Parameters
    ----------
    period
        of the joint states, s
    source
        how the period is known, in a word
    timeouts, max_time_step
        as they are set, s

    Returns
    -------
    list[str]
        one sentence for each value; nothing where all is well
    """
    least = {
        "joint_state_timeout": (timeouts.joint_state_timeout, STATES_WITHIN_TIMEOUT * period),
        "max_time_step": (max_time_step, period),
    }
    come = f"joint states come every {period:.3g} s ({source})"
    return [
        f"{name} is {value:g} s, but {come}: set it to {needed:.3g} s or more"
        for name, (value, needed) in least.items()
        if value < needed * (1.0 - RATE_TOLERANCE)
    ]
