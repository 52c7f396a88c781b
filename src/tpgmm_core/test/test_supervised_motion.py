# SPDX-License-Identifier: Apache-2.0
"""Joint positions for a robot that takes them: begin, end, and everything that may stop on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tpgmm_core.control.joint_motion import JointStep
from tpgmm_core.control.motion_aims import Aim
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.control.supervised_motion import MotionTimeouts, SupervisedMotion
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.robot.model import RobotModel

UR5 = RobotModel.from_file(Path(__file__).resolve().parents[3] / "config" / "ur5.yaml")
ARM = UR5.indices("arm")
MS = 1_000_000
#: Largest acceleration, as it is by default, rad/s^2.
ACCELERATION = 5.0


class Bench:
    """A robot that is at once where it is told, joint states and references at 100 Hz, and what was sent."""

    def __init__(self, offset: tuple[float, float, float] = (0.1, 0.1, 0.1), **timeouts: float) -> None:
        self.supervised = SupervisedMotion(UR5, "tool", ARM, timeouts=MotionTimeouts(**timeouts))
        self.now_ns, self.q = 1000 * MS, UR5.home.copy()
        data = UR5.create_data()
        data.update(UR5.home)
        self.home = data.pose("tool")
        self.aim = Aim.of_pose("tool", PoseReference(self.home + np.array([*offset, 0, 0, 0, 0]), 1e-6 * np.eye(6)))
        self.sent: list[JointStep] = []
        self.obeys = True

    def run(self, seconds: float, states: bool = True, references: bool = True) -> None:
        for _ in range(round(100 * seconds)):
            self.now_ns += 10 * MS
            if states:
                self.supervised.take_state(self.q, self.now_ns, self.now_ns, self.now_ns)
            if references:
                self.supervised.take_reference([self.aim], self.now_ns, self.now_ns, self.now_ns)
            self.step()

    def step(self) -> None:
        step = self.supervised.step(self.now_ns)
        if step is None:
            return
        # it never jumps: from the measured joints on, within the acceleration
        last_q, last_v = (self.sent[-1].q, self.sent[-1].v) if self.sent else (self.q[ARM], np.zeros(6))
        if self.obeys:
            np.testing.assert_allclose(step.q, last_q + 0.01 * step.v, atol=1e-9)
        assert (np.abs(step.v - last_v) <= ACCELERATION * 0.01 + 1e-9).all()
        self.sent.append(step)
        if self.obeys:
            self.q[ARM] = step.q

    @property
    def says(self) -> tuple[ControllerMode, str]:
        return self.supervised.mode, self.supervised.reason

    @property
    def missing(self) -> float:
        data = UR5.create_data()
        data.update(self.q)
        return float(np.linalg.norm((data.pose("tool") - self.aim.mean)[:3]))


def test_it_begins_at_the_measured_joints_of_a_robot_that_rests_and_gets_there() -> None:
    bench = Bench()
    assert bench.says == (ControllerMode.WAITING, "no joint state yet")
    bench.q = UR5.home + 0.2  # not where the model would be by itself
    bench.run(0.3, references=False)
    assert bench.says == (ControllerMode.WAITING, "no reference yet: nothing is sent") and not bench.sent
    bench.run(0.02)
    assert bench.says == (ControllerMode.ACTIVE, "following the reference")
    np.testing.assert_allclose(bench.sent[0].q, UR5.home + 0.2, atol=1e-3)
    bench.run(5.0)
    assert bench.missing < 1e-3


def test_a_robot_that_moves_is_not_taken_over() -> None:
    bench = Bench()
    for _ in range(30):
        bench.q = bench.q + 0.01
        bench.run(0.01)
    assert not bench.sent and bench.says[1].startswith("waiting until the robot has been at rest for 0.1 s")
    bench.run(0.3)
    assert bench.sent and bench.says[0] is ControllerMode.ACTIVE


def test_references_that_stop_lead_to_a_hold_and_then_to_silence() -> None:
    bench = Bench(offset=(0.1, 0.3, 0.1), reference_timeout=0.1, hold_time=0.5)
    bench.run(1.0)
    assert not bench.sent[-1].at_rest
    bench.run(0.12, references=False)
    assert bench.says == (ControllerMode.HOLD, "no reference for 0.1 s: stops")
    bench.run(0.4, references=False)
    assert bench.sent[-1].at_rest and bench.says == (ControllerMode.HOLD, "no reference for 0.1 s: holds")
    bench.run(0.3, references=False)
    count = len(bench.sent)
    bench.run(0.3, references=False)
    assert len(bench.sent) == count and bench.says[0] is ControllerMode.WAITING
    assert bench.says[1] == "no reference for 0.1 s: nothing is sent"
    bench.sent.clear()
    bench.run(5.0)  # another movement, from where the robot is
    assert bench.missing < 1e-3


def test_joint_states_that_stop_lead_to_a_hold_which_ends_where_they_come_again() -> None:
    # what is told goes on for longer than the lag that is allowed: the robot is not measured, which is all that is said
    bench = Bench(offset=(0.1, 0.35, 0.1), joint_state_timeout=0.5, max_lag=0.05)
    bench.run(1.0)
    bench.run(0.8, states=False)
    assert bench.sent[-1].at_rest and bench.says == (ControllerMode.HOLD, "no new joint state for 0.5 s: holds")
    assert np.abs(bench.sent[-1].q - bench.sent[-80].q).max() > 0.05
    bench.run(5.0)
    assert bench.missing < 1e-3


def test_a_robot_that_does_not_follow_is_told_to_stay_where_it_is_and_waits_for_the_next_movement() -> None:
    bench = Bench(offset=(0.1, 0.3, 0.1), hold_time=2.0)
    bench.run(0.3)
    bench.obeys = False  # an emergency stop
    bench.run(2.0)
    mode, reason = bench.says
    assert mode is ControllerMode.HOLD and "does not follow: " in reason and "next movement" in reason
    np.testing.assert_allclose(bench.sent[-1].q, bench.q[ARM], atol=1e-9)
    bench.obeys = True  # let go: nothing moves, whatever comes
    before = bench.q.copy()
    bench.run(1.0)
    np.testing.assert_allclose(bench.q, before, atol=1e-9)
    bench.run(0.5, references=False)
    bench.run(6.0)
    assert bench.missing < 1e-3


def test_what_cannot_be_reached_is_said_with_the_cause() -> None:
    bench = Bench(offset=(1.0, 0.0, 0.0))
    bench.run(8.0)
    mode, reason = bench.says
    assert mode is ControllerMode.HOLD and reason.startswith("cannot follow: ") and "no progress" in reason


def state_in_the_past(bench: Bench) -> None:
    bench.supervised.take_state(bench.q, bench.now_ns - 500 * MS, bench.now_ns, bench.now_ns)


def state_of_the_future(bench: Bench) -> None:
    bench.supervised.take_state(bench.q, bench.now_ns + 500 * MS, bench.now_ns, bench.now_ns)


def state_that_stands_still(bench: Bench) -> None:
    bench.supervised.take_state(bench.q, 1000 * MS, bench.now_ns, bench.now_ns)


def state_outside_the_limits(bench: Bench) -> None:
    bench.supervised.take_state(bench.q + 7.0, bench.now_ns, bench.now_ns, bench.now_ns)


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (state_in_the_past, "behind this machine's clock"),
        (state_of_the_future, "ahead of this machine's clock"),
        (state_that_stands_still, "their stamps stay at 1.000 s"),
        (state_outside_the_limits, "outside the joint limits: shoulder_pan_joint"),
    ],
)
def test_joint_states_that_cannot_be_used_begin_nothing_and_are_named(
    state: Callable[[Bench], None], words: str
) -> None:
    bench = Bench()
    for _ in range(50):
        bench.now_ns += 10 * MS
        state(bench)
        bench.supervised.take_reference([bench.aim], bench.now_ns, bench.now_ns, bench.now_ns)
        bench.step()
    assert not bench.sent and words in bench.says[1]


def test_references_that_are_refused_age_with_the_reason() -> None:
    bench = Bench()
    bench.run(0.5)
    for _ in range(40):
        bench.now_ns += 10 * MS
        bench.supervised.take_state(bench.q, bench.now_ns, bench.now_ns, bench.now_ns)
        with pytest.raises(ValueError, match="ahead of this machine's clock"):
            bench.supervised.take_reference([bench.aim], bench.now_ns + 500 * MS, bench.now_ns, bench.now_ns)
        bench.step()
    assert bench.says[0] is ControllerMode.HOLD and "the newest was refused: its stamp is more than" in bench.says[1]


def test_at_the_end_the_joints_come_to_rest() -> None:
    bench = Bench()
    bench.run(0.5)
    last = bench.sent[-1]
    steps = 0
    while (step := bench.supervised.release(bench.now_ns + (steps + 1) * 10 * MS)) is not None:
        assert (np.abs(step.v - last.v) <= ACCELERATION * 0.01 + 1e-9).all()
        last, steps = step, steps + 1
    assert 0 < steps < 50 and last.at_rest


def test_a_clock_that_is_set_back_moves_nothing() -> None:
    bench = Bench()
    bench.run(0.5)
    q = bench.supervised.motion.q.copy()
    assert bench.supervised.step(bench.now_ns - 300 * MS) is None
    np.testing.assert_array_equal(bench.supervised.motion.q, q)


def test_a_robot_that_is_told_poses_chooses_its_joints_and_only_its_hand_has_to_follow() -> None:
    panda = RobotModel.from_file(Path(__file__).resolve().parents[3] / "config" / "panda.yaml")
    supervised = SupervisedMotion(panda, "hand", panda.indices("arm"), by_pose=True)
    data, now = panda.create_data(), 1000 * MS
    data.update(panda.home)
    home, q = data.pose("hand"), panda.home.copy()
    aim = Aim.of_pose("hand", PoseReference(home + np.array([0.05, 0.1, -0.05, 0, 0, 0, 0]), 1e-6 * np.eye(6)))

    def run(seconds: float) -> None:
        nonlocal now
        for _ in range(round(100 * seconds)):
            now += 10 * MS
            supervised.take_state(q, now, now, now)
            supervised.take_reference([aim], now, now, now)
            if supervised.step(now) is None:
                continue
            # the robot's own law: to the pose by the shortest way of its joints, which drift where they are free
            for _ in range(3):
                data.update(q)
                J, error = data.jacobian("hand"), POSE.log(data.pose("hand"), supervised.motion.pose("hand"))
                q[:] += np.linalg.pinv(J) @ error
            data.update(q)
            J = data.jacobian("hand")
            free = np.linalg.svd(J)[2][-1]
            q[:] += 0.004 * free * np.sign(free[0])

    run(1.5)
    assert supervised.mode is ControllerMode.ACTIVE, supervised.reason
    assert np.abs(q - panda.home).max() > 0.3, "farther than joints may lag behind"
    assert supervised.lag.largest < 0.01 and set(supervised.lag.values) == {"hand_lag_mm", "hand_lag_deg"}
    assert np.abs(q - supervised.motion.q).max() < 0.2, "the limits are those of the measured joints"
    for _ in range(45):  # somebody leads the arm elsewhere
        q[3] += 0.02
        now += 10 * MS
        supervised.take_state(q, now, now, now)
    supervised.step(now)
    assert supervised.mode is ControllerMode.HOLD and "the robot does not follow: hand is" in supervised.reason


def test_positions_that_leap_are_left_out_and_where_only_they_come_the_joints_stop() -> None:
    bench = Bench(offset=(0.1, 0.3, 0.1))
    bench.run(0.3)
    sound, wrong = bench.supervised.take_state, UR5.indices("arm")[2]
    heard = 0

    def with_leaps(q: np.ndarray, *times: int) -> None:
        nonlocal heard
        heard += 1
        sound(q + (heard % 10 == 0) * np.eye(UR5.nv)[wrong], *times)

    bench.supervised.take_state = with_leaps  # type: ignore[method-assign]
    for _ in range(100):
        bench.run(0.05)
        assert bench.says[0] is ControllerMode.ACTIVE
    assert bench.missing < 1e-3
    bench.supervised.take_state = sound  # type: ignore[method-assign]
    sent, bench.obeys = len(bench.sent), False
    bench.q[wrong] += 1.0
    bench.run(2.0)
    mode, reason = bench.says
    assert mode is ControllerMode.WAITING and f"{UR5.joint_names[wrong]} leapt by 0.99 rad" in reason
    assert np.abs(np.diff([step.q for step in bench.sent[sent:]], axis=0)).max() < 1e-3
