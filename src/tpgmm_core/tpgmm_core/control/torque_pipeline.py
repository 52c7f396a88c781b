# SPDX-License-Identifier: Apache-2.0
"""`TorquePipeline`: from the torques of a law to those that are sent to the motors, in a fixed order.

1. finite: a torque that is not is replaced by the safe one: gravity compensation with damping.
2. size: one torque for each joint of the robot. (Names are matched where messages are read.)
3. blend-in: after a start or an interruption the law takes over from the safe torque, over `recovery_time`.
4. limits of positions and speeds: no torque drives a joint beyond them (`clamp_at_limits`).
5. repulsion from the margin before the position limits (`repel`).
6. effort and rate: `|tau| <= effort limit` and `|tau - last tau| <= torque_rate dt` are one interval per joint. Where
   the robot file gives a rate of the robot's own, the smaller one counts, and no more than one period of it at once:
   the robot compares with the torque of its last cycle, however long our pause was. Which one that was is not known
   where several were sent within a period, so that no torque is farther than this from any of them.
7. power: the power that the motors put into the motion is at most `max_power`.

**What holds at the output.** Finite, within the effort limits, within the rate limit: always, and at once. The
last torque was within the effort limits, so that their interval and that of the rate overlap, and nothing that
comes after stage 6 leaves them. Stages 3 to 5 and 7 are fulfilled as far as that interval permits. So the rate wins
over the power limit: a torque that drives too much falls as fast as the rate permits, within 67 ms at the default even
from one effort limit to the other. If the power limit or a clamp won, a torque would jump where one of them becomes
active, which gears and people feel at once, while power needs time to become motion.

**Which power.** `(tau - nonlinear)^T v`, without what lifts or lowers the robot's own weight: the rate at which
the motors feed kinetic energy, and the energy of what the robot touches. A limit on `tau^T v` would drop an arm that is
lifted too fast.

With dt = 0 nothing changes, whatever the law asks for: the last torque is repeated.

**The delay of the loop.** Damping and repulsion answer a speed of the past: where they are too fast for the delay
(`control.delay_margin`), they are made weaker.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import DynamicState
from tpgmm_core.control.delay_margin import OF_CRITICAL, borne_share, joint_damping
from tpgmm_core.control.torque_limits import (
    blend,
    clamp_at_limits,
    finite,
    keep_within,
    limit_power,
    repel,
    torque_bounds,
)
from tpgmm_core.geometry.kernels import compiled, is_finite
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.robot.model import RobotModel

#: What a step did beside passing a torque on, by the bits of `limit_torques`.
ACTIONS = ("not finite", "joint limit", "repulsion", "effort or rate", "power")
NOT_FINITE, AT_LIMIT, REPELLED, BOUNDED, POWER = (1 << i for i in range(len(ACTIONS)))
#: The robot's own rate limit is kept by this share, so that rounding does not exceed it.
ROUNDING = 1e-6
#: A joint's speed towards its limit falls no faster than this share of the rate with which that is enforced.
GENTLY = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueLimits(Settings):
    """Parameters of the pipeline."""

    torque_rate: float = setting(
        30.0, 0.1, 1e3, "Largest rate of change of a torque, as a share of the joint's effort limit, 1/s"
    )
    max_power: float = setting(80.0, 1.0, 1e5, "Largest power that the motors may put into the motion, W")
    recovery_time: float = setting(0.3, 1e-3, 60.0, "Time over which control fades in again after an interruption, s")
    approach_rate: float = setting(
        10.0, 0.1, 1e3, "Largest speed towards a position limit, per distance that is left, 1/s"
    )
    limit_bandwidth: float = setting(
        100.0, 1.0, 500.0, "Bandwidth with which joints are braked at position and speed limits, 1/s"
    )
    repulsion_margin: float = setting(
        0.05, 0.0, 1.0, "Margin before position limits out of which joints are pushed back, rad or m"
    )
    repulsion_frequency: float = setting(
        20.0, 0.1, 100.0, "Bandwidth with which joints are pushed back out of that margin, rad/s"
    )
    safe_damping: float = setting(2.0, 0.0, 50.0, "Damping of each joint while the controller only brakes, N m s/rad")
    max_time_step: float = setting(0.005, 1e-3, 1.0, "Longest time step that the controller computes with, s")


@compiled
def limit_torques(
    tau: Array,
    q: Array,
    v: Array,
    nonlinear: Array,
    inverse: Array,
    acting: Array,
    dt: float,
    delay: float,
    share: float,
    lower: Array,
    upper: Array,
    max_speed: Array,
    effort: Array,
    own_rates: Array,
    period: float,
    torque_rate: float,
    max_power: float,
    approach_rate: float,
    limit_bandwidth: float,
    repulsion_margin: float,
    repulsion_frequency: float,
    safe_damping: float,
    safe: Array,
) -> int:
    """Stages 1 and 3 to 7 of the pipeline, in place: see the module.

    Parameters
    ----------
    tau
        (n,), N m, changed: the torques that a law asks for, then those that may be sent
    q, v
        state (n,), rad and rad/s, or m and m/s
    nonlinear
        (n,), N m, what carries the robot at q and v: gravity and Coriolis torques
    inverse
        (n, n), M^-1
    acting
        (m, n), N m, those that the robot may still apply when these come, the last one at the end; NaN: none
    dt
        time since the last one, s
    delay
        of the loop, s
    share
        of the law in the blend with the safe torque, 0 to 1
    lower, upper
        position limits (n,), rad or m
    max_speed
        (n,), rad/s or m/s
    effort
        (n,), effort limits, N m
    own_rates
        (n,), rates that the robot itself permits, N m/s; infinite where it says nothing
    period
        of the robot's own cycle, s
    torque_rate, max_power, approach_rate, limit_bandwidth, repulsion_margin, repulsion_frequency, safe_damping
        see `TorqueLimits`
    safe
        (n,), N m, written: gravity compensation with damping

    Returns
    -------
    int
        the bits of what was done, in the order of `ACTIONS`
    """
    n = len(tau)
    done = 0
    mass, lowest, highest, change = np.zeros(n), np.empty(n), np.empty(n), np.empty(n)
    known = finite(q) and finite(v) and finite(nonlinear)
    for i in range(n):
        safe[i] = 0.0 if not known else nonlinear[i]
        if known:
            mass[i] = 1.0 / inverse[i, i]
            known = known and is_finite(mass[i])
    if known:
        limit_bandwidth *= borne_share(OF_CRITICAL / limit_bandwidth, delay)
        approach_rate = min(approach_rate, GENTLY * limit_bandwidth)
        repulsion_frequency *= borne_share(0.5 * OF_CRITICAL / repulsion_frequency, delay)
        damping = np.empty(n)
        joint_damping(safe_damping, 0.5 * limit_bandwidth, mass, inverse, delay, damping)
        for i in range(n):
            safe[i] -= damping[i] * v[i]
    if not known or not finite(tau):
        done |= NOT_FINITE
        for i in range(n):
            tau[i] = safe[i]
    else:
        blend(tau, safe, share)
    if known:
        if clamp_at_limits(tau, q, v, nonlinear, mass, lower, upper, max_speed, effort, approach_rate, limit_bandwidth):
            done |= AT_LIMIT
        if repel(tau, q, v, mass, lower, upper, repulsion_margin, repulsion_frequency):
            done |= REPELLED
    for i in range(n):
        change[i] = torque_rate * dt * effort[i]
        if own_rates[i] < np.inf:
            change[i] = min(change[i], (1.0 - ROUNDING) * own_rates[i] * min(dt, period))
    torque_bounds(effort, acting[-1], change, lowest, highest)
    for k in range(len(acting) - 1):
        for i in range(n):
            if own_rates[i] < np.inf:
                farthest = (1.0 - ROUNDING) * own_rates[i] * period
                lowest[i] = max(lowest[i], acting[k, i] - farthest)
                highest[i] = min(highest[i], acting[k, i] + farthest)
    if keep_within(tau, lowest, highest):
        done |= BOUNDED
    if known and limit_power(tau, v, nonlinear, max_power, lowest, highest):
        done |= POWER
    for i in range(n):
        # numbers so large that the stages overflowed: the permitted torque nearest to zero
        if not is_finite(tau[i]):
            done |= NOT_FINITE
            tau[i] = min(max(0.0, lowest[i]), highest[i])
    return done


class TorquePipeline:
    """Passes torques on, within limits; remembers the last ones.

    Parameters
    ----------
    robot
        whose limits are kept
    limits
        further ones
    period
        from one torque that the robot applies to the next, s; infinite: as long as between two steps
    """

    def __init__(self, robot: RobotModel, limits: TorqueLimits | None = None, period: float = math.inf) -> None:
        self.robot, self._period = robot, period
        # where no joint has a rate of the robot's own, only the last torques count
        is_judged = math.isfinite(period) and bool(np.isfinite(robot.torque_rates).any())
        self._period_ns = round(period * SECOND) if is_judged else 0
        self.configure(limits or TorqueLimits())
        self.reset()
        moment = DynamicState.at(robot.create_data(), robot.home, np.zeros(robot.nv))
        self.step(moment.nonlinear, moment, 0.0)  # compiles
        self.reset()

    def configure(self, limits: TorqueLimits) -> None:
        """Use other limits, from the next step on."""
        self.limits = limits

    def reset(self) -> None:
        """Forget the last torques: the next ones have no rate to keep. Only while none act on the robot."""
        self._sent: list[tuple[int, Array]] = []
        self.restart()

    def restart(self) -> None:
        """Begin to blend in again, from the safe torque."""
        self._blend = 0.0

    def acts(self, tau: Array) -> None:
        """Note that other torques (nv,) than the last ones act on the robot now: the rate limit refers to these."""
        self._sent = [(self._sent[-1][0] if self._sent else 0, tau)]

    def step(
        self, wanted: Array | None, moment: DynamicState, dt: float, now_ns: int | None = None
    ) -> tuple[Array, int]:
        """Limit the torques of a law; see the module.

        Parameters
        ----------
        wanted
            (nv,), of the law; None: the safe torque, to which all is blended at once
        moment
            the state of the robot
        dt
            since the last step, s; a pause counts as `max_time_step`, NaN and steps backwards as none
        now_ns
            when these torques are sent, ns, on a clock that does not jump; None: dt after the last ones

        Returns
        -------
        tuple[Array, int]
            shape (nv,), N m, and the bits of what was changed (see `ACTIONS`)

        Raises
        ------
        ValueError
            for a torque of the wrong shape
        """
        limits, robot = self.limits, self.robot
        dt = self.time_step(dt)
        if wanted is None:
            self._blend, tau = 0.0, np.zeros(robot.nv)
        else:
            if wanted.shape != (robot.nv,):
                raise ValueError(f"the law gives torques of shape {wanted.shape}, expected ({robot.nv},)")
            self._blend = min(1.0, self._blend + dt / limits.recovery_time)
            tau = np.array(wanted, dtype=np.float64)
        safe = np.empty(robot.nv)
        if now_ns is None:
            now_ns = round(dt * SECOND) + (self._sent[-1][0] if self._sent else 0)
        self._sent = self._in_force(now_ns)
        acting = [before for _, before in self._sent] or [np.full(robot.nv, np.nan)]
        done = limit_torques(
            tau,
            moment.q,
            moment.v,
            moment.nonlinear,
            moment.inverse,
            np.array(acting),
            dt,
            moment.loop.delay,
            smoothstep(self._blend),
            robot.lower_limits,
            robot.upper_limits,
            robot.velocity_limits,
            robot.effort_limits,
            robot.torque_rates,
            self._period,
            limits.torque_rate,
            limits.max_power,
            limits.approach_rate,
            limits.limit_bandwidth,
            limits.repulsion_margin,
            limits.repulsion_frequency,
            limits.safe_damping,
            safe,
        )
        if done & NOT_FINITE:
            self._blend = 0.0
        self._sent.append((now_ns, tau))
        return tau.copy(), done

    def _in_force(self, now_ns: int) -> list[tuple[int, Array]]:
        """The torques that the robot may have applied within its last period, with when they were sent, ns."""
        sent = [(min(sent_ns, now_ns), tau) for sent_ns, tau in self._sent]  # simulated time may begin anew
        replaced_ns = [sent_ns for sent_ns, _ in sent[1:]]
        return [
            one for one, end_ns in zip(sent, replaced_ns, strict=False) if end_ns > now_ns - self._period_ns
        ] + sent[-1:]

    def time_step(self, dt: float) -> float:
        """The dt that the pipeline counts; 0 for NaN and for a step backwards, so that nothing may change."""
        return min(dt, self.limits.max_time_step) if dt > 0.0 else 0.0


def actions(done: int) -> tuple[str, ...]:
    """The bits of a step in words."""
    return tuple(name for i, name in enumerate(ACTIONS) if done >> i & 1)
