# SPDX-License-Identifier: Apache-2.0
"""A simulated robot whose joint states come late: it follows as far as that can be borne, and never swings.

`make test` tries some random robots, postures, gains, delays and laws;
`make properties` (TPGMM_PROPERTY_SEQUENCES=10000) some hundred.
"""

from __future__ import annotations

import os
import re

import numpy as np
import pytest

from long_tests import mostly_long

pytest.importorskip("pinocchio")

from delayed_loop import DelayedLoop, LoopRecord, joint_reference, pose_reference
from robots import CONFIG
from tpgmm_core.control.loop_guard import burden
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.robot.model import RobotModel

COUNT = max(8, int(os.environ.get("TPGMM_PROPERTY_SEQUENCES", "150")) // 50)
ROBOTS = {"baxter": "left", "panda": "hand", "ur5": "tool", "xarm7": "tool"}
AWAY = np.array([0.0, 0.06, 0.04, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def robots() -> dict[str, RobotModel]:
    return {name: RobotModel.from_file(CONFIG / f"{name}.yaml") for name in ROBOTS}


def assert_calm(robot: RobotModel, record: LoopRecord) -> None:
    """Nothing swings, and in the end nothing moves much."""
    assert not any("swings" in reason for reason in record.reasons), record.reasons
    assert np.isfinite(record.tau).all() and (np.abs(record.tau) <= robot.effort_limits).all()
    quarter = len(record.v) // 4
    before = record.fastest(slice(None, -quarter), robot.velocity_limits)
    last = record.fastest(slice(-quarter, None), robot.velocity_limits)
    assert last < max(0.1, 0.8 * before), f"joints at {last:.2f} of their speed limits in the end, {before:.2f} before"


def age_in(reason: str) -> int:
    """Of the states, ms, as the reason has it: told anew where it has changed by a tenth."""
    found = re.search(r"(\d+) ms old", reason)
    assert found, reason
    return int(found[1])


@pytest.mark.parametrize("seed", mostly_long(range(COUNT), 0, 1, 2, 3))
def test_whatever_the_robot_the_posture_the_gains_the_delay_and_the_law_nothing_swings(
    robots: dict[str, RobotModel], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    name = list(ROBOTS)[seed % len(ROBOTS)]
    robot, endpoint = robots[name], ROBOTS[name]
    arm = robot.indices(robot.endpoints[endpoint].joints)
    lower, upper = np.maximum(robot.lower_limits, -np.pi), np.minimum(robot.upper_limits, np.pi)
    q0 = robot.home.copy()
    # anywhere between home and a random posture, not at the stops
    share = rng.uniform(0.0, 0.6)
    q0[arm] += share * (rng.uniform(lower + 0.2 * (upper - lower), upper - 0.2 * (upper - lower))[arm] - q0[arm])
    late, varies = rng.uniform(0.0, 0.1), rng.uniform(0.0, 0.01)
    law = ("infinite_horizon", "risk_sensitive")[rng.integers(2)]
    period = float(rng.choice([0.001, 0.002, 0.005, 0.01]))
    deviation = 10.0 ** rng.uniform(-3.0, -1.0)
    loop = DelayedLoop(
        robot, endpoint, lambda _: max(0.0, late + rng.uniform(-varies, varies)), law=law, q0=q0, period=period
    )
    loop.run(200)
    if rng.random() < 0.5:
        reference = pose_reference(loop.pose() + AWAY * rng.uniform(-1.0, 1.0), deviation)
    else:
        names = tuple(robot.joint_names[i] for i in arm)
        goal = loop.simulator.state.q[arm] + rng.uniform(-0.1, 0.1, len(arm))
        reference = joint_reference(goal, 3.0 * deviation, names)
    assert_calm(robot, loop.run(3000, reference))


@pytest.mark.parametrize("late_ms", mostly_long([0, 20, 30, 60], 0, 30))
@pytest.mark.parametrize("name", ["panda", "baxter"])
def test_a_firm_reference_is_followed_as_long_as_that_can_be_borne_and_it_says_so(
    robots: dict[str, RobotModel], name: str, late_ms: int
) -> None:
    robot = robots[name]
    loop = DelayedLoop(robot, ROBOTS[name], lambda _: 1e-3 * late_ms)
    loop.run(100)
    goal = loop.pose() + AWAY
    record = loop.run(2500, pose_reference(goal, 0.002))
    assert_calm(robot, record)
    away = np.linalg.norm(loop.pose()[:3] - goal[:3])
    reason = record.reasons[-1]
    if late_ms == 60:
        assert record.modes[-1] == ControllerMode.DAMPING
        assert age_in(reason) == pytest.approx(late_ms, rel=0.1) and "stable up to 7 ms" in reason
        return
    assert record.modes[-1] == ControllerMode.ACTIVE and away < 0.02
    assert (reason == "following the reference") == (late_ms == 0)
    assert late_ms == 0 or age_in(reason) == pytest.approx(late_ms, rel=0.1)


def test_states_that_become_late_in_the_middle_of_a_movement_are_answered_before_it_swings(
    robots: dict[str, RobotModel],
) -> None:
    loop = DelayedLoop(robots["panda"], "hand", lambda t: 0.04 if t > 0.5 else 0.001)
    loop.run(100)
    record = loop.run(2500, pose_reference(loop.pose() + AWAY, 0.005))
    assert_calm(robots["panda"], record)
    assert record.shares[390] > 0.95 and record.shares[-1] < 0.4


def test_it_follows_again_when_states_come_in_time_again(robots: dict[str, RobotModel]) -> None:
    loop = DelayedLoop(robots["ur5"], "tool", lambda t: 0.08 if t < 1.0 else 0.001)
    loop.run(100)
    reference = pose_reference(loop.pose() + AWAY, 0.002)
    assert loop.run(800, reference).modes[-1] == ControllerMode.DAMPING
    record = loop.run(6000, reference)
    assert_calm(robots["ur5"], record)
    assert record.modes[-1] == ControllerMode.ACTIVE and record.reasons[-1] == "following the reference"


@pytest.mark.parametrize("late_ms", [30, 60])
def test_a_delay_that_no_stamp_tells_of_is_found_by_the_swings_and_borne_afterwards(
    robots: dict[str, RobotModel], late_ms: int
) -> None:
    robot = robots["panda"]
    loop = DelayedLoop(robot, "hand", lambda _: 1e-3 * late_ms, tells=False)
    loop.run(100)
    reference = pose_reference(loop.pose() + AWAY, 0.01)
    record = loop.run(1500, reference)
    assert any("oscillates and does not settle" in reason for reason in record.reasons)
    assert record.modes[-1] == ControllerMode.DAMPING
    again = loop.run(6000, reference)
    alarms = [reason for reason in again.reasons if "swings" in reason]
    assert len(set(alarms)) <= 1  # the one that goes on
    if late_ms == 30:
        assert again.modes[-1] == ControllerMode.ACTIVE and again.shares[-1] < 0.7
    assert "it oscillated as if torques arrived" in again.reasons[-1]
    assert again.fastest(slice(-1000, None), robot.velocity_limits) < 0.1


def test_swings_of_an_arm_that_can_hardly_hold_its_weight_are_not_put_down_to_a_delay(
    robots: dict[str, RobotModel],
) -> None:
    robot, arm = robots["baxter"], [f"left_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
    assert burden(robot, robot.home) == ""
    stretched = robot.home.copy()
    stretched[robot.indices(arm)] = [-0.17, -0.3, -1.14, 0.68, 0.86, 1.62, -0.37]
    loop = DelayedLoop(robot, "left", lambda _: 0.06, q0=stretched, tells=False)
    loop.run(100)
    record = loop.run(4000, pose_reference(loop.pose() + AWAY, 0.01))
    assert ControllerMode.DAMPING in record.modes
    needs = r"left_s1 needs \d+ of its 50 N m to hold the robot's weight"
    told = " / ".join(record.reasons)
    assert re.search(rf"does not settle \([^)]*\): {needs}", told) and re.search(
        f"it oscillated where {needs}", told
    ), told
    assert "torques came" not in told


def test_an_obstacle_that_goes_away_lets_nothing_leap(robots: dict[str, RobotModel]) -> None:
    robot = robots["panda"]
    loop = DelayedLoop(robot, "hand", lambda _: 0.0)
    loop.run(100)
    start = loop.pose()
    reference = pose_reference(start + 2.0 * AWAY, 0.05, turning=2.0)

    def wall(_: float) -> dict[str, list[float]]:
        back = np.clip(-4000.0 * (loop.pose() - start)[:3], -150.0, 150.0)
        return {"panda_hand_tcp": [*back, 0.0, 0.0, 0.0]}

    blocked = loop.run(4000, reference, wall)
    assert blocked.modes[-1] == ControllerMode.HOLD
    assert "not following" in blocked.reasons[-1] and "something holds it" in blocked.reasons[-1]
    free = loop.run(6000, reference)
    assert free.fastest(slice(None), robot.velocity_limits) < 0.25
    assert free.modes[-1] == ControllerMode.ACTIVE
    assert np.linalg.norm(loop.pose()[:3] - (start + 2.0 * AWAY)[:3]) < 0.04


@pytest.mark.parametrize("pause_ms", [1, 5, 40])
def test_no_torque_changes_by_more_than_the_robot_itself_permits_also_after_a_pause(
    robots: dict[str, RobotModel], pause_ms: int
) -> None:
    """The Panda stops at 1 N m per ms: from a rest, towards leaping references, struck, and after ticks were lost."""
    robot = robots["panda"]
    assert (robot.torque_rates == 1000.0).all()
    loop = DelayedLoop(robot, "hand", lambda t: 0.001 * pause_ms if 0.9 < t < 0.9 + 1e-3 * pause_ms else 0.0)
    torques = [loop.run(200).tau]
    start = loop.pose()
    torques.append(loop.run(600, pose_reference(start + 2.0 * AWAY, 0.002)).tau)
    torques.append(loop.run(400, pose_reference(start - AWAY, 0.002)).tau)
    state = loop.simulator.state
    loop.simulator.reset(state.q, state.v + np.array([0.4, -0.4, 0.3, 0.0, 0.0, 0.5, 0.0]))
    torques.append(loop.run(300, pose_reference(start, 0.002)).tau)
    steps = np.abs(np.diff(np.concatenate(torques), axis=0))
    assert steps.max() < 1.0
    assert steps.max() > 0.9  # it was tried
