# SPDX-License-Identifier: Apache-2.0
"""What a controller does about the age of its reference."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from tpgmm_core.settings import check_settings, setting


class ControllerMode(enum.IntEnum):
    """As in ``tpgmm_msgs/ControllerState``."""

    WAITING = 0  # no joint state yet: no torque
    ACTIVE = 1  # follows the reference
    HOLD = 2  # holds the last reference with its stiffness
    DAMPING = 3  # carries the robot's weight and damps its motion
    FAULT = 4  # input that cannot be used: as DAMPING, with the reason


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceTimeouts:
    """When a reference is followed, held and let go of."""

    reference_timeout: float = setting(0.1, 0.002, 10.0, "A reference that is older is not followed but held, s")
    hold_time: float = setting(1.0, 0.0, 600.0, "It is held for this long and then let go of, s")

    def __post_init__(self) -> None:
        """Raises ValueError for a value out of its range."""
        check_settings(self)


def mode_of(age: float | None, timeouts: ReferenceTimeouts) -> tuple[ControllerMode, str]:
    """The mode for a reference of this age (s, None: never one), and the reason in words."""
    if age is None:
        return ControllerMode.DAMPING, "no reference yet"
    if age <= timeouts.reference_timeout:
        return ControllerMode.ACTIVE, "following the reference"
    if age <= timeouts.reference_timeout + timeouts.hold_time:
        return ControllerMode.HOLD, f"no reference for {timeouts.reference_timeout:g} s: holding the last one"
    return (
        ControllerMode.DAMPING,
        f"no reference for {timeouts.reference_timeout + timeouts.hold_time:g} s: gravity compensation",
    )
