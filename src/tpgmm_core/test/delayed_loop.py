# SPDX-License-Identifier: Apache-2.0
"""A simulated robot whose joint states come late: the controller under supervision, a clock, and what lies between."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.control.laws import LawSettings, LawTarget, ReferenceLaw
from tpgmm_core.control.supervised_controller import SupervisedController
from tpgmm_core.control.supervision import Timeouts
from tpgmm_core.control.torque_pipeline import TorqueLimits
from tpgmm_core.control.yielding import YieldConfig
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.external_torques import ExternalTorques
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

Array = NDArray[np.float64]

MS = 1_000_000
#: A force is judged every so many ms.
FEELS = 20
#: Nobody is silent here, however late a message is, and however few there are.
PATIENT = {"joint_state_timeout": 1.0, "silence_after": 1.0}


@dataclass(frozen=True, slots=True)
class LoopRecord:
    """What happened, one row for each ms: q, v, tau (T, nv); modes (T,); shares of the gains (T,); reasons."""

    q: Array
    v: Array
    tau: Array
    modes: Array
    shares: Array
    reasons: tuple[str, ...]

    def fastest(self, of: slice, limits: Array) -> float:
        """Largest speed of a joint within some steps, as a share of its limit."""
        return float((np.abs(self.v[of]) / limits).max(initial=0.0))


class DelayedLoop:
    """A tick is a ms. States reach the controller `delay(time)` s late, with true stamps, `period` s apart.

    Parameters
    ----------
    law
        its name
    endpoint
        that references of poses are for
    tells
        whether the controller is to know how old states are: else it takes the stamps for those of another clock
    motors
        what lies between torques and motors, s, of which nobody knows
    yield_force
        force on the hand that it yields to, by measured torques, N
    """

    def __init__(
        self,
        robot: RobotModel,
        endpoint: str,
        delay: Callable[[float], float],
        *,
        law: str = "infinite_horizon",
        settings: LawSettings | None = None,
        q0: Array | None = None,
        period: float = 0.001,
        tells: bool = True,
        motors: float = 0.0,
        limits: TorqueLimits | None = None,
        yield_force: float = 0.0,
    ) -> None:
        self.robot, self.endpoint, self._delay = robot, endpoint, delay
        self.simulator = RobotSimulator(robot, q0=q0)
        of_law = ReferenceLaw(law, robot, endpoint, settings)
        limits = limits or TorqueLimits(max_time_step=max(0.005, period))
        timeouts = Timeouts(**PATIENT, max_age=1.0 if tells else 0.0)
        self.controller: SupervisedController[LawTarget] = SupervisedController(
            robot, of_law, limits, timeouts, YieldConfig(yield_force=yield_force), period=period
        )
        self._external = ExternalTorques(robot, endpoint) if yield_force else None
        self.now_ns = 1_000_000 * MS
        self._period_ns, self._began_ns = round(period * 1e9), self.now_ns
        self._sent: deque[tuple[int, int, Array, Array]] = deque()  # arrival, stamp, q, v
        self._torques = deque([self.weight(self.simulator.state.q)] * (1 + round(1e3 * motors)))
        self._data = robot.create_data()

    def weight(self, q: Array) -> Array:
        """What carries the robot at q (nv,)."""
        return self.robot.create_data().gravity(q).copy()

    def pose(self) -> Array:
        """Of the end point, (7,)."""
        self._data.update(self.simulator.state.q)
        return self._data.pose(self.endpoint).copy()

    def twist(self) -> Array:
        """Of the end point, (6,)."""
        self._data.update(self.simulator.state.q, self.simulator.state.v)
        return self._data.twist(self.endpoint).copy()

    def run(
        self,
        ticks: int,
        reference: Callable[[float], Reference] | Reference | None = None,
        wrenches: Callable[[float], dict[str, Sequence[float]]] = lambda _: {},
    ) -> LoopRecord:
        """So many ms, with a reference by the time (s since the start of this run) or one that stays."""
        rows: list[tuple[Array, Array, Array, int, float]] = []
        reasons: list[str] = []
        for tick in range(ticks):
            self.now_ns += MS
            time, state, guarded = 1e-3 * tick, self.simulator.state, self.controller
            if reference is not None:
                given = reference if isinstance(reference, Reference) else reference(time)
                guarded.take_reference(given, self.now_ns, self.now_ns, self.now_ns)
            if (self.now_ns - self._began_ns) % self._period_ns == 0:
                late = self._delay(1e-9 * (self.now_ns - self._began_ns))
                self._sent.append((self.now_ns + round(late * 1e9), self.now_ns, state.q, state.v))
            arrived = [item for item in self._sent if item[0] <= self.now_ns]
            self._sent = deque(item for item in self._sent if item[0] > self.now_ns)
            tau = self._torques[-1]
            if self._external is not None:
                self._external.take(self.now_ns, state.q, state.v, state.tau)
                if tick % FEELS == 0:
                    self._external.step()
                    force = self._external.hand_force() if self._external.is_known else None
                    guarded.take_force(force, self.now_ns)
            for _, stamp_ns, q, v in arrived[-1:]:  # only the newest is read
                answer = guarded.take_state(q, v, stamp_ns, self.now_ns, self.now_ns)
                if answer is not None:
                    tau = answer.command.tau
            self._torques.append(tau)
            self.simulator.step(self._torques.popleft(), wrenches(time))
            decision = guarded.decision
            if not reasons or reasons[-1] != decision.reason:
                reasons.append(decision.reason)
            rows.append((state.q, state.v, tau, int(decision.mode), guarded.guard.share))
        q, v, tau, modes, shares = map(np.array, zip(*rows, strict=True))
        return LoopRecord(q, v, tau, modes, shares, tuple(reasons))


def pose_reference(pose: Array, deviation: float, turning: float = 10.0) -> Reference:
    """A pose that stays, with a standard deviation in m, and `turning` times as many rad."""
    spread = np.repeat([deviation**2, (turning * deviation) ** 2], 3)
    return Reference(0.5, Gaussian(pose, np.diag(spread), POSE), 0.0, (), np.ones(1), ("object",))


def joint_reference(positions: Array, deviation: float, names: tuple[str, ...]) -> Reference:
    """Joints that stay, with a standard deviation in rad."""
    gaussian = Gaussian(positions, deviation**2 * np.eye(len(positions)))
    return Reference(0.5, gaussian, 0.0, (), np.ones(1), ("object",), names)
