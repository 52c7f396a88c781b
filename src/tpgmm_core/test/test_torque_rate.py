# SPDX-License-Identifier: Apache-2.0
"""How fast torques change as a robot sees it: in each cycle it applies the last ones that have come until then."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import CONFIG
from tpgmm_core.common.types import Array
from tpgmm_core.control.impedance import ImpedanceLaw
from tpgmm_core.control.pose_target import PoseTarget
from tpgmm_core.control.supervised_controller import Answer, SupervisedController
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

MS, PERIOD_NS, PERMITTED = 1_000_000, 1_000_000, 1.0
AWAY = np.array([0.0, 0.12, 0.08, 0.0, 0.0, 0.0, 0.0])


class Irregular:
    """A Panda at 1 kHz whose states are handled late, each by another time, and references that leap in between.

    `sent` has when torques were sent, ns, and what.
    """

    def __init__(self, seed: int) -> None:
        self.robot = RobotModel.from_file(CONFIG / "panda.yaml")
        self.random, self.simulator = np.random.default_rng(seed), RobotSimulator(self.robot)
        self.controller: SupervisedController[PoseTarget] = SupervisedController(
            self.robot, ImpedanceLaw(self.robot, "hand"), period=1e-3
        )
        data = self.robot.create_data()
        data.update(self.robot.home)
        self.home, self.again = data.pose("hand"), 0
        self.sent: list[tuple[int, Array]] = []

    def _note(self, answer: Answer | None, now_ns: int) -> None:
        if answer is not None:
            self.sent.append((now_ns, answer.command.tau))

    def run(self, cycles: int) -> None:
        """So many joint states, of which some are lost, and some are answered again."""
        for stamp_ns in 1000 * MS + PERIOD_NS * np.arange(cycles):
            state = self.simulator.state
            if self.random.random() > 0.05:
                now_ns = int(stamp_ns + self.random.integers(0, PERIOD_NS))
                self._refer(int(stamp_ns), now_ns)
                self._note(self.controller.take_state(state.q, state.v, int(stamp_ns), now_ns, now_ns), now_ns)
                later_ns = now_ns + int(self.random.integers(1, 8 * PERIOD_NS // 10))
                if later_ns < stamp_ns + PERIOD_NS:
                    self._refer(later_ns, later_ns)
                    answer = self.controller.answer_again(later_ns)
                    self.again += answer is not None
                    self._note(answer, later_ns)
            self.simulator.step(self.sent[-1][1] if self.sent else state.q * 0.0)

    def _refer(self, stamp_ns: int, now_ns: int) -> None:
        gaussian = Gaussian(self.home + self.random.uniform(-1.0, 1.0) * AWAY, 1e-5 * np.eye(6), POSE)
        reference = Reference(0.5, gaussian, 0.0, (), np.ones(1), ("object",))
        self.controller.take_reference(reference, stamp_ns, now_ns, now_ns)

    def largest_change(self, phase_ns: int) -> float:
        """From one of the robot's cycles to the next, N m, where these begin at this time after the stamps."""
        times = np.array([now_ns for now_ns, _ in self.sent])
        torques = np.array([tau for _, tau in self.sent])
        cycles = np.arange(times[0] + phase_ns, times[-1], PERIOD_NS)
        applied = torques[np.searchsorted(times, cycles, side="right") - 1]
        return float(np.abs(np.diff(applied, axis=0)).max())


@pytest.mark.parametrize("seed", range(4))
def test_from_one_cycle_of_the_robot_to_the_next_no_torque_changes_faster_than_it_permits(seed: int) -> None:
    """A Panda stops where one changes by more than 1 N m per ms, however its messages and ours are delayed."""
    loop = Irregular(seed)
    assert (loop.robot.torque_rates == 1e3 * PERMITTED).all()
    loop.run(400)
    assert loop.again > 50, "states were answered again"
    changes = [loop.largest_change(phase_ns) for phase_ns in range(0, PERIOD_NS, PERIOD_NS // 50)]
    assert max(changes) <= PERMITTED
    assert max(changes) > 0.9 * PERMITTED  # it was tried
