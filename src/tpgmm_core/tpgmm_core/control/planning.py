# SPDX-License-Identifier: Apache-2.0
"""What laws that look ahead share: their parameters, when they plan, and in which thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from tpgmm_core.common.settings import Settings, setting

#: Runs a piece of work, at once or in another thread; the future holds its result.
type Submit[PlanT] = Callable[[Callable[[], PlanT]], Future[PlanT]]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanConfig(Settings):
    """Parameters of the laws that look ahead; see `lqr.receding_horizon` for the risk."""

    plan_rate: float = setting(100.0, 1.0, 1000.0, "Rate at which laws with a horizon make a new plan, Hz")
    risk_share: float = setting(
        0.5,
        -10.0,
        10.0,
        "Caution under uncertainty: share of control authority given to the worst case; below 0: optimism",
    )
    risk_stiffness: float = setting(
        100.0, 1e-3, 1e4, "Stiffness at which risk_share applies; it grows where the robot is softer, 1/s^2"
    )
    plan_horizon: float = setting(0.5, 0.05, 5.0, "Horizon of the predictive law, s")
    plan_speed: float = setting(1.0, 1e-2, 10.0, "Largest speed that the predictive law plans for a joint, rad/s")
    plan_margin: float = setting(0.06, 0.0, 1.0, "Distance that the predictive law keeps from position limits, rad")


@runtime_checkable
class Planning(Protocol):
    """What looks ahead, a law or its gains: its `plan` may be set at any time, before `configure`."""

    plan: PlanConfig


def at_once[PlanT](work: Callable[[], PlanT]) -> Future[PlanT]:
    """Do the work now and wait for the result: a `Submit` whose numbers do not depend on the speed of the machine."""
    future: Future[PlanT] = Future()
    try:
        future.set_result(work())
    except Exception as error:  # the caller gets it with the result
        future.set_exception(error)
    return future


class Schedule:
    """When to plan, counted in the time of the steps; the first time at once."""

    def __init__(self) -> None:
        self._age = float("inf")

    def due(self, dt: float, rate: float) -> bool:
        """Whether a plan should begin now, dt s after the last call, `rate` times per s."""
        self._age += dt
        # half a step of rounding must not cost a whole one
        return self._age >= 1.0 / rate - 0.5 * dt

    def begun(self) -> None:
        """A plan has begun."""
        self._age = 0.0
