# SPDX-License-Identifier: Apache-2.0
"""An arm whose hand somebody holds: soft while it is held, never by itself, and back without a leap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from delayed_loop import DelayedLoop, LoopRecord, joint_reference, pose_reference
from robots import BAXTER
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.control.yielding import SOFT, SOFTENS, STIFFENS, YieldConfig, Yielding
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.led_hand import LedHand
from tpgmm_core.robot.model import RobotModel

Array = NDArray[np.float64]
HAND, THRESHOLD = "left_gripper", 15.0
#: Where the person leads the hand to, from where it is to be, m.
AWAY = np.array([0.0, 0.1, 0.15, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


@dataclass(frozen=True)
class Led:
    """A hand that was held and let go of: N at the end of the hold, m away then, and speeds (T,) after it."""

    force: float
    away: float
    speeds: Array
    held: LoopRecord
    after: LoopRecord
    left: float


def lead_away(loop: DelayedLoop, reference: Reference, after: int) -> Led:
    """Hold the hand of an arm that follows a reference, lead it away, let go, and wait for `after` ms."""
    loop.run(700, reference)
    begin, forces = loop.pose(), [0.0]
    person = LedHand(begin)

    def holds(time: float) -> dict[str, Array]:
        wrench = person.wrench(1e-3, begin + min(1.0, time) * AWAY, loop.pose(), loop.twist())
        forces.append(float(np.linalg.norm(wrench[:3])))
        return {HAND: wrench}

    held = loop.run(1700, reference, holds)
    away = float(np.linalg.norm(loop.pose()[:3] - begin[:3]))
    record = loop.run(after, reference)
    data, speeds = loop.robot.create_data(), []
    for q, v in zip(record.q, record.v, strict=True):
        data.update(q, v)
        speeds.append(float(np.linalg.norm(data.twist(loop.endpoint)[:3])))
    left = float(np.linalg.norm(loop.pose()[:3] - begin[:3]))
    return Led(float(np.mean(forces[-200:])), away, np.array(speeds), held, record, left)


def of_pose(loop: DelayedLoop) -> Reference:
    return pose_reference(loop.pose(), 0.005)


def of_joints(loop: DelayedLoop) -> Reference:
    arm = loop.robot.indices("left_arm")
    return joint_reference(loop.simulator.state.q[arm], 0.02, tuple(loop.robot.joint_names[i] for i in arm))


@pytest.mark.parametrize(
    ("law", "refers"),
    [
        ("infinite_horizon", of_pose),
        ("infinite_horizon", of_joints),
        pytest.param("predictive", of_pose, marks=pytest.mark.long),
    ],
)
def test_a_hand_that_is_held_is_led_with_little_force_and_does_not_leap_back(
    robot: RobotModel, law: str, refers: Callable[[DelayedLoop], Reference]
) -> None:
    stiff, soft = (
        DelayedLoop(robot, "left", lambda _: 0.002, law=law, yield_force=force) for force in (0.0, THRESHOLD)
    )
    without, led = lead_away(stiff, refers(stiff), 300), lead_away(soft, refers(soft), 4000)
    firm, yields = without.force / without.away, led.force / led.away
    print(f"\n{law}: {firm:.0f} -> {yields:.0f} N/m, {without.speeds.max():.2f} -> {led.speeds.max():.2f} m/s")
    assert led.away > without.away and yields < 0.4 * firm
    assert led.speeds.max() < 0.9 * without.speeds.max()
    assert led.left < 0.01
    assert led.held.modes[-1] == ControllerMode.HOLD and f"held with more than {THRESHOLD:g} N" in led.held.reasons[-1]
    # it does not say that it follows before it does, nor that it is held for ever
    assert "comes nearer, slowly" in led.after.reasons[1]
    assert led.after.reasons[-1] == "following the reference" and led.after.modes[-1] == ControllerMode.ACTIVE


def test_an_arm_that_nobody_touches_never_yields(robot: RobotModel) -> None:
    loop = DelayedLoop(robot, "left", lambda _: 0.002, yield_force=THRESHOLD)
    begin = loop.pose()

    def moving(time: float) -> Reference:
        aim = begin.copy()
        aim[:3] += 0.08 * (1.0 - np.cos(np.pi * time)) * np.array([0.3, 0.6, 0.6])
        return pose_reference(aim, 0.005)

    record = loop.run(2500, moving)
    assert not any("held" in reason for reason in record.reasons), record.reasons
    assert float(np.linalg.norm(loop.pose()[:3] - moving(2.5).gaussian.mean[:3])) < 0.02


def shares(yielding: Yielding, forces: list[tuple[float | None, float]]) -> list[float]:
    """The share of the gains after each force, which lasts for so many s; ticks of 10 ms."""
    found, tick = [], 0
    for force, lasts in forces:
        for _ in range(round(100 * lasts)):
            tick += 1
            yielding.feel(0.01 * tick, force)
            yielding.step(0.01)
        found.append(yielding.share)
    return found


def test_gains_fall_fast_and_come_back_slowly() -> None:
    yielding = Yielding(YieldConfig(yield_force=THRESHOLD))
    assert shares(yielding, [(0.0, 1.0), (30.0, 0.2 + SOFTENS)]) == pytest.approx([1.0, SOFT])
    (share,) = shares(yielding, [(0.0, 1.0)])
    assert SOFT < share < 1.0 and "softer" in yielding.words  # the force has to be gone for a while first
    assert shares(yielding, [(0.0, STIFFENS)]) == [1.0] and not yielding.words


@pytest.mark.parametrize("force", [None, 30.0])
def test_what_cannot_be_known_and_what_was_always_there_is_no_hold(force: float | None) -> None:
    yielding = Yielding(YieldConfig(yield_force=THRESHOLD))
    assert shares(yielding, [(force, 3.0)]) == [1.0] and not yielding.is_held
    words = yielding.feel(10.0, force)
    assert ("from the beginning" in words and "7.5 N" in words) if force else not words


def test_a_hand_whose_force_is_no_longer_measured_is_not_held_and_another_threshold_begins_anew() -> None:
    yielding = Yielding(YieldConfig(yield_force=THRESHOLD))
    shares(yielding, [(0.0, 1.0), (30.0, 1.0)])
    assert yielding.is_held
    yielding.configure(YieldConfig(yield_force=THRESHOLD))
    assert yielding.is_held
    yielding.feel(2.1, None)
    assert not yielding.is_held
    shares(yielding, [(0.0, 1.0), (30.0, 1.0)])
    yielding.configure(YieldConfig())
    assert not yielding.is_held and not yielding.is_possible
    assert shares(yielding, [(0.0, 1.0), (30.0, 2.0 + STIFFENS)])[-1] == 1.0
