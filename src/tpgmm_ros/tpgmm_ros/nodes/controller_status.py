# SPDX-License-Identifier: Apache-2.0
"""What controllers tell of themselves: the mode and why, how late they are, and what limits took away."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecyclePublisher
from rclpy.node import Node

from tpgmm_core.control.controller import TorqueCommand
from tpgmm_core.control.loop_guard import LoopGuard
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros.messages import conversions
from tpgmm_ros.runtime.monitor import RecentTimes

#: How often a mode is told again, and other words for the same mode are told at most, ns.
PERIOD_NS = 100_000_000
#: Of modes in which the robot does not do what it should.
LEVELS = {
    ControllerMode.FAULT: DiagnosticStatus.ERROR,
    ControllerMode.HOLD: DiagnosticStatus.WARN,
    ControllerMode.WAITING: DiagnosticStatus.WARN,
}


class ControllerStatus:
    """The mode of a controller and why: on `controller_state`, in the log, and for `/diagnostics`."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.mode, self.reason = ControllerMode.WAITING, "not active"
        self._words_due_ns = 0

    def begin(self, publisher: LifecyclePublisher, base_frame: str) -> None:
        """Tell on this publisher from now on."""
        self._publisher, self._base_frame = publisher, base_frame

    def change(self, mode: ControllerMode, reason: str, now_ns: int) -> None:
        """Tell each change of the mode at once, and other words for the same mode now and then."""
        if mode is self.mode and (reason == self.reason or not _is_due(self._words_due_ns, now_ns)):
            return
        self.mode, self.reason, self._words_due_ns = mode, reason, now_ns + PERIOD_NS
        text, logger = f"{mode.name}: {reason}", self._node.get_logger()
        if mode is ControllerMode.FAULT:
            logger.error(text)
        else:
            logger.info(text)
        self._publisher.publish(self._message())

    def end(self, now_ns: int) -> None:
        """Tell that the controller is not active any more."""
        self._words_due_ns = 0
        self.change(ControllerMode.WAITING, "not active", now_ns)

    def diagnosis(self, values: dict[str, str], trouble: str = "") -> tuple[bytes, str, dict[str, str]]:
        """What `Monitor` takes, with further values; `trouble` in place of the reason."""
        return LEVELS.get(self.mode, DiagnosticStatus.OK), f"{self.mode.name}: {trouble or self.reason}", values

    def _message(self) -> ControllerState:
        now_ns = self._node.get_clock().now().nanoseconds
        header = conversions.header_at(now_ns, self._base_frame)
        return ControllerState(header=header, state=int(self.mode), reason=self.reason)


class TorqueStatus(ControllerStatus):
    """The same of a controller that sends torques, with their terms.

    Attributes
    ----------
    actions
        how often each stage of the pipeline took something away
    ages
        of joint states by their stamps
    """

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self.actions: Counter[str] = Counter()
        self.forget()

    def forget(self) -> None:
        """Begin anew, with nothing known of what was sent before."""
        self._words_due_ns = self._terms_due_ns = 0
        self.actions.clear()
        self.ages = RecentTimes()

    def tell(self, command: TorqueCommand, joints: Sequence[str], now_ns: int) -> None:
        """Tell what torques are made of, if it is time to."""
        if not _is_due(self._terms_due_ns, now_ns):
            return
        self._terms_due_ns = now_ns + PERIOD_NS
        message = self._message()
        message.joints = list(joints)
        feedforward = command.tau if command.law is None else command.law.terms["feedforward"]
        message.feedforward_torque = conversions.floats(feedforward)
        message.feedback_torque = conversions.floats(command.tau - feedforward)
        message.term_names, message.terms = conversions.torque_terms(command.terms)
        if command.law is not None:
            message.stiffness = conversions.floats(command.law.stiffness)
            message.damping = conversions.floats(command.law.damping)
        self._publisher.publish(message)


def _is_due(due_ns: int, now_ns: int) -> bool:
    """Whether a time has come; also where the clock was set back since it was chosen."""
    return not 0 < due_ns - now_ns <= PERIOD_NS


def loop_values(guard: LoopGuard, ages: RecentTimes) -> dict[str, str]:
    """How old joint states are by their stamps, what the gains in use would bear, and what share of them is in use."""
    values = {"state_age_p50_ms": "unknown", "state_age_p99_ms": "unknown"}
    if ages.count and guard.age.age is not None:
        p50, p99 = ages.percentile_ms(50, 99)
        values = {"state_age_p50_ms": f"{p50:.2f}", "state_age_p99_ms": f"{p99:.2f}"}
    followed = math.isfinite(guard.tolerated)
    values["tolerated_age_ms"] = f"{1e3 * guard.tolerated:.1f}" if followed else "no reference"
    values["state_period_ms"] = f"{1e3 * guard.age.period:.2f}"
    values["gain_share"] = f"{guard.share:.2f}"
    if guard.age.suspected > 1e-3:
        values["suspected_delay_ms"] = f"{1e3 * guard.age.suspected:.0f}"
    return values


def limited(actions: Mapping[str, int]) -> str:
    """How often each stage of the pipeline took something away."""
    return ", ".join(f"{name}: {count} ticks" for name, count in sorted(actions.items()))
