# SPDX-License-Identifier: Apache-2.0
"""What a controller does about the age and the validity of what it gets; time is an argument everywhere."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from tpgmm_core.settings import check_settings, setting

SECOND = 1_000_000_000
#: A clock that is behind a message by no more than this has been overtaken by it; by more, it has jumped back, s.
OVERTAKEN = 0.05


class ControllerMode(enum.IntEnum):
    """As in ``tpgmm_msgs/ControllerState``."""

    WAITING = 0  # no joint states: no torques
    ACTIVE = 1  # follows the reference
    HOLD = 2  # holds the last reference with its stiffness, or cannot get to it and is pulled a little only
    DAMPING = 3  # carries the robot's weight and damps its motion: no reference, or one that cannot be followed safely
    FAULT = 4  # joint states that cannot be used: as DAMPING at the last good one, then no torques


@dataclass(frozen=True, slots=True, kw_only=True)
class Timeouts:
    """When a joint state or a reference is too old, and which stamps are none."""

    joint_state_timeout: float = setting(0.02, 0.002, 10.0, "Without joint states for this long: damping, s")
    silence_after: float = setting(0.2, 0.0, 10.0, "Damping without joint states for this long, then silence, s")
    reference_timeout: float = setting(0.1, 0.002, 10.0, "A reference that is older is not followed but held, s")
    hold_time: float = setting(1.0, 0.0, 600.0, "It is held for this long and then let go of, s")
    max_age: float = setting(
        0.1,
        0.0,
        10.0,
        "A joint state whose stamp is older is refused, s; 0: stamps of a clock that is not this machine's",
    )
    actuation_delay: float = setting(0.001, 0.0, 0.1, "From a message with torques to the torques of the motors, s")
    max_future: float = setting(0.05, 0.001, 10.0, "A stamp that lies further ahead of the clock is refused, s")

    def __post_init__(self) -> None:
        """Raises ValueError for a value out of its range."""
        check_settings(self)


@dataclass(frozen=True, slots=True)
class Inputs:
    """What is known of the inputs at one time.

    state_age : s since the last good joint state; None: never one
    state_fault : why the newest joint state was refused; empty when it was good
    reference_age : s since the last good reference, by arrival or by stamp, whichever is more; None: never one
    reference_fault : why the newest reference was refused; empty when it was good
    """

    state_age: float | None
    state_fault: str
    reference_age: float | None
    reference_fault: str


@dataclass(frozen=True, slots=True)
class Decision:
    """A mode, why, and whether torques are sent in it."""

    mode: ControllerMode
    reason: str
    sends: bool


def decide(inputs: Inputs, timeouts: Timeouts) -> Decision:
    """What is to be done about inputs of these ages. The joint states come first: without them nothing is known."""
    patience = timeouts.joint_state_timeout + timeouts.silence_after
    if inputs.state_fault:
        in_time = inputs.state_age is not None and inputs.state_age <= patience
        return Decision(ControllerMode.FAULT, f"joint state refused: {inputs.state_fault}", in_time)
    if inputs.state_age is None:
        return Decision(ControllerMode.WAITING, "no joint state yet", False)
    if inputs.state_age > patience:
        return Decision(ControllerMode.WAITING, f"no new joint state for {patience:g} s: silent", False)
    if inputs.state_age > timeouts.joint_state_timeout:
        words = f"no new joint state for {timeouts.joint_state_timeout:g} s: gravity compensation where it was last"
        return Decision(ControllerMode.DAMPING, words, True)
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


class Stamp(enum.Enum):
    """What a message's stamp says about it."""

    NEW = enum.auto()
    REPEATED = enum.auto()  # the stamp of the last message: nothing new, however often it comes
    OLD = enum.auto()  # overtaken by a newer one on its way
    FUTURE = enum.auto()
    RESTARTED = enum.auto()  # older, after all that was newer has become stale: time has jumped backwards


class StreamWatch:
    """Tells the messages of one stream that are new from those that are not, and how old the last one is.

    Times in ns: stamps, `now_ns` of the clock that watches (steady), `clock_ns` of the clock of the stamps.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """No message yet."""
        self.stamp_ns: int | None = None
        self._received_ns = 0

    def age(self, now_ns: int) -> float | None:
        """Seconds since the last message came; None without one, infinite where the clock itself jumped backwards."""
        if self.stamp_ns is None:
            return None
        age = 1e-9 * (now_ns - self._received_ns)
        return max(0.0, age) if age >= -OVERTAKEN else math.inf

    def judge(self, stamp_ns: int, now_ns: int, clock_ns: int, timeout: float, max_future: float) -> Stamp:
        """What a message with this stamp is; it counts as the last one only if it is then accepted.

        timeout : after which the last message is stale, s. Only then an older stamp is a clock that jumped.
        clock_ns : 0 while that clock is not known, in which case no stamp is called future.
        """
        if clock_ns > 0 and stamp_ns - clock_ns > max_future * SECOND:
            return Stamp.FUTURE
        age = self.age(now_ns)
        if self.stamp_ns is None or age is None or stamp_ns > self.stamp_ns:
            return Stamp.NEW
        if stamp_ns == self.stamp_ns:
            return Stamp.REPEATED
        return Stamp.RESTARTED if age > timeout else Stamp.OLD

    def accept(self, stamp_ns: int, now_ns: int) -> None:
        """A message that counts as the last one."""
        self.stamp_ns, self._received_ns = stamp_ns, now_ns
