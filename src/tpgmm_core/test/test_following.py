# SPDX-License-Identifier: Apache-2.0
"""Whether a robot follows, and the words for why it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import CONFIG, write_arm
from tpgmm_core.control.control_law import Lag, LawTorques
from tpgmm_core.control.following import PATIENCE, ProgressWatch
from tpgmm_core.robot.model import RobotModel


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return RobotModel.from_file(CONFIG / "panda.yaml")


def asked(robot: RobotModel, lag: Lag, q: np.ndarray | None = None, **changes: object) -> LawTorques:
    data, zero = robot.create_data(), np.zeros(robot.nv)
    data.update(robot.home if q is None else q)
    jacobian = data.jacobian(next(iter(robot.endpoints)))
    law = LawTorques(zero, {}, np.zeros(6), np.eye(6), np.eye(6), jacobian, 1.0, False, "", lag=lag)
    return replace(law, **changes)


def waited(
    watch: ProgressWatch, robot: RobotModel, law: LawTorques, q: np.ndarray | None = None, ticks: int = 2500
) -> str:
    for _ in range(ticks):
        watch.step(robot.home if q is None else q, np.zeros(robot.nv), law, 0.001)
    return watch.reason


def test_who_is_far_and_comes_no_nearer_does_not_follow_until_it_is_near(panda: RobotModel) -> None:
    watch = ProgressWatch(panda)
    assert not waited(watch, panda, asked(panda, Lag(0.12, 0.1)), ticks=round(1e3 * PATIENCE) - 1)
    reason = waited(watch, panda, asked(panda, Lag(0.12, 0.1)), ticks=2)
    assert reason == (
        "not following, 120 mm and 6 deg from the reference, no progress: "
        "something holds it, or its stiffness is too low"
    )
    assert waited(watch, panda, asked(panda, Lag(0.045, 0.1)), ticks=1)
    assert not waited(watch, panda, asked(panda, Lag(0.03, 0.1)), ticks=1)


def test_who_was_held_and_comes_back_slowly_is_not_said_to_be_held(panda: RobotModel) -> None:
    watch = ProgressWatch(panda)
    assert "something holds it" in waited(watch, panda, asked(panda, Lag(0.3, 0.0)))
    for distance in np.linspace(0.3, 0.2, 4100):
        watch.step(panda.home, np.zeros(panda.nv), asked(panda, Lag(float(distance), 0.0)), 0.001)
    assert watch.reason.startswith("not following yet, 2") and "it comes nearer, slowly" in watch.reason
    assert "something holds it" in waited(watch, panda, asked(panda, Lag(0.2, 0.0)), ticks=4100)


@pytest.mark.parametrize("lag", [Lag(0.04, 0.0), Lag(0.0, 0.2)])
def test_who_is_near_follows_however_long(panda: RobotModel, lag: Lag) -> None:
    assert not waited(ProgressWatch(panda), panda, asked(panda, lag), ticks=5000)


def test_who_comes_nearer_follows_and_so_does_who_keeps_up_with_a_reference_that_moves(panda: RobotModel) -> None:
    watch = ProgressWatch(panda)
    for distance in np.linspace(1.0, 0.06, 3000):
        watch.step(panda.home, np.zeros(panda.nv), asked(panda, Lag(float(distance), 0.0)), 0.001)
    assert not watch.reason
    assert not waited(watch, panda, asked(panda, Lag(0.12, 0.0), asked=1.0, moves=0.8))
    assert "moves away" in waited(watch, panda, asked(panda, Lag(0.12, 0.0), asked=1.0, moves=0.1))


def test_the_reason_names_joints_at_their_stops_and_motors_at_their_limits_with_units(panda: RobotModel) -> None:
    q = panda.home.copy()
    q[3] = -3.06
    assert "at joint limit: panda_joint4, -3.06 rad" in waited(
        ProgressWatch(panda), panda, asked(panda, Lag(0.2, 0.0)), q
    )
    watch, tau = ProgressWatch(panda), np.zeros(panda.nv)
    tau[1] = -87.0
    for _ in range(2500):
        watch.step(panda.home, tau, asked(panda, Lag(0.2, 0.0)), 0.001)
    assert "at effort limit: panda_joint2, -87 N m" in watch.reason


def test_the_reason_says_where_a_hand_is_stretched_out(panda: RobotModel) -> None:
    q = np.array([0.0, 0.1, 0.0, -0.5, 0.0, 1.5, 0.785])
    assert "singular" in waited(ProgressWatch(panda), panda, asked(panda, Lag(0.2, 0.0), q), q)
    assert "singular" not in waited(ProgressWatch(panda), panda, asked(panda, Lag(0.2, 0.0)))


def test_prismatic_joints_are_named_in_metres(tmp_path: object) -> None:
    robot = RobotModel.from_file(write_arm(tmp_path))  # type: ignore[arg-type]
    assert robot.joint_units == ("rad", "m")
    q = np.array([0.0, 0.49])
    law = asked(robot, Lag(0.0, 0.5, "slide"))
    reason = waited(ProgressWatch(robot), robot, replace(law, jacobian=np.eye(2)), q)
    assert "slide is 0.50" in reason and "at joint limit: slide, 0.49 m" in reason
