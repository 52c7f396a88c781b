# SPDX-License-Identifier: Apache-2.0
"""`Convergence`: how a dynamical system reaches its goal."""

from __future__ import annotations

from dataclasses import dataclass

from tpgmm_core.common.settings import Settings, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence(Settings):
    """How a system comes to its goal.

    Raises
    ------
    ValueError
        for a value out of its range
    """

    rate: float = setting(
        2.0, 0.1, 20.0, "Rate of convergence: the goal is reached within about 3 / rate durations at the latest"
    )
    goal_rate: float = setting(
        20.0, 0.1, 100.0, "Rate of the spring that ends the movement, close to the goal, per duration"
    )
    detour: float = setting(0.5, 0.0, 10.0, "Share by which the distance to the goal may grow before it shrinks")
    metres_per_radian: float = setting(0.2, 1e-3, 10.0, "Length that an angle counts as in distances, m/rad")
    arrival: float = setting(0.002, 1e-6, 0.1, "Distance from the goal at which the movement has ended, m")
    leash: float = setting(0.05, 1e-3, 10.0, "Distance from the reference beyond which the robot pulls it along, m")
    leash_speed: float = setting(0.5, 1e-3, 10.0, "Largest speed with which the robot pulls the reference along, m/s")
