# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller does about joint states that come late, and arms that swing or do not follow."""

from __future__ import annotations

import re

import numpy as np

from faults.late_bench import AT_REST, AWAY, FIRM, ORDINARY, RATE, SOFT, LateBench
from faults.table import fault
from ros_graph import set_parameters
from tpgmm_core.control.loop_guard import RETRY
from tpgmm_core.control.supervision import Timeouts
from tpgmm_msgs.msg import ControllerState

#: No age is measured where it is 0.
ANOTHER_CLOCK = 0.0
#: Of the loop's delay, beside age and period of the states, ms.
MOTORS = 1e3 * Timeouts().actuation_delay
#: By which two processes may see an age differently, ms.
TOLERANCE = 2.0


def sent_away(bench: LateBench, deviation: float, seconds: float = 3.0) -> str:
    """Ask for a movement and let it end; AssertionError where the arm swings, or does not come to rest."""
    bench.deviation = deviation
    bench.goal = bench.pose() + AWAY
    bench.clear()
    bench.spin_for(seconds)
    fastest, last, torque = float(bench.speeds().max()), bench.speed(), bench.torque()
    assert fastest < ORDINARY, f"a joint moved at {fastest:.2f} of its limit"
    assert last < AT_REST, f"a joint still moves at {last:.2f} of its limit"
    assert not any("swings" in message.reason for message in bench.modes.messages)
    assert torque <= 1.0 + 1e-9
    ages = bench.diagnostics.values["impedance_controller"]
    return (
        f"largest speed {100 * fastest:.0f} % and torque {100 * torque:.0f} % of the limits, "
        f"{1e3 * bench.away():.1f} mm from the goal; {', '.join(bench.said())}: {bench.modes.last.reason}; "
        f"age p50 {ages['state_age_p50_ms']} ms, "
        f"tolerated {ages['tolerated_age_ms']} ms"
    )


def enter_late(late_ms: int, varies_ms: int = 0) -> None:
    about = f" (varying by {varies_ms} ms)" if varies_ms else ""

    @fault(
        LateBench,
        f"joint states {late_ms} ms old{about}, firm references",
        "followed with gains that bear it, and it says so; no swings. Where the machine adds so much that no useful "
        "gains bear it: DAMPING, with figures that are right",
        quick=False,  # wants a machine with nothing else to do
    )
    def late(bench: LateBench) -> str:
        with bench.ages() as ages:
            bench.delay(1e-3 * late_ms, 1e-3 * varies_ms)
            bench.spin_for(0.5)
            ages.clear()
            observed = sent_away(bench, FIRM)
        added = f"the machine adds {1e3 * np.median(ages) - late_ms:.1f} ms by itself"
        if bench.is_in(ControllerState.DAMPING, "gains are stable up to"):
            return f"{observed}; {added}; {assert_too_late(bench.modes.last.reason, ages)}"
        assert bench.is_in(ControllerState.ACTIVE, "ms old according to their stamps"), bench.modes.last
        assert bench.away() < 0.02
        return f"{observed}; {added}"


def assert_too_late(reason: str, ages: list[float]) -> str:
    """What the controller says of the delay is what others see, and no useful gains bear it; in words."""
    said = re.search(r"the loop is (\d+) ms late in total; .* the softest usable ones up to (\d+) ms", reason)
    assert said is not None, reason
    late, usable = map(int, said.groups())
    rest = 1e3 / RATE + MOTORS
    usual, longest = (rest + 1e3 * np.percentile(ages, (50, 99))).tolist()
    assert RETRY * usable < late, f"not late enough for that: {reason}"
    assert usual - TOLERANCE < late < longest + TOLERANCE, f"seen from here {usual:.0f} to {longest:.0f} ms: {reason}"
    assert longest > usable - TOLERANCE, f"the machine adds too little to explain it, {longest:.0f} ms in all: {reason}"
    return f"{usual:.0f} to {longest:.0f} ms in all, which nothing useful bears: rightly DAMPING"


enter_late(20)
enter_late(30)
enter_late(20, 10)


@fault(
    LateBench,
    "joint states 60 ms old, firm references",
    "DAMPING: no useful gains tolerate it; the reason has the age and the tolerated age",
)
def too_late(bench: LateBench) -> str:
    bench.delay(0.06)
    bench.spin_for(0.5)
    observed = sent_away(bench, FIRM)
    assert bench.is_in(ControllerState.DAMPING, "ms old according to their stamps"), bench.modes.last
    assert "gains are stable up to" in bench.modes.last.reason
    return observed


@fault(LateBench, "joint states 60 ms old, soft references", "followed, more slowly: soft gains bear more", quick=False)
def late_and_soft(bench: LateBench) -> str:
    bench.delay(0.06)
    bench.spin_for(0.5)
    observed = sent_away(bench, 5.0 * SOFT, 6.0)
    assert bench.is_in(ControllerState.ACTIVE), bench.modes.last
    return observed


@fault(
    LateBench,
    "joint states become 40 ms old in the middle of a movement",
    "gains fall within some ten ms, before a swing has begun",
)
def suddenly_late(bench: LateBench) -> str:
    bench.deviation, bench.goal = 2.0 * FIRM, bench.pose() + AWAY
    bench.clear()
    bench.spin_for(0.4)
    bench.delay(0.04)
    bench.spin_for(3.0)
    fastest, last = float(bench.speeds().max()), bench.speed()
    assert last < AT_REST, f"in the end {last:.2f} of a speed limit"
    assert not any("swings" in message.reason for message in bench.modes.messages)
    return f"largest speed {100 * fastest:.0f} % of a limit; {', '.join(bench.said())}: {bench.modes.last.reason}"


@fault(
    LateBench,
    "joint states older than max_age",
    "FAULT with the reason: refused as if none came, then nothing",
)
def beyond_max_age(bench: LateBench) -> str:
    assert set_parameters(bench.node, "impedance_controller", max_age=0.02).successful
    bench.delay(0.06)
    took = bench.wait(lambda: bench.is_in(ControllerState.FAULT, "behind this machine's clock"), "FAULT")
    bench.wait(lambda: bench.speed() < AT_REST, "rest")
    observed = f"FAULT within {took:.2f} s ({bench.modes.last.reason})"
    assert set_parameters(bench.node, "impedance_controller", max_age=0.2).successful
    return observed


@fault(
    LateBench,
    "joint states 40 ms late whose stamps do not tell",
    "swings are noticed: DAMPING with the reason; once calm it follows with gains that bear it, or says why not",
    quick=False,
)
def late_unawares(bench: LateBench) -> str:
    assert set_parameters(bench.node, "impedance_controller", max_age=ANOTHER_CLOCK).successful
    bench.delay(0.04)
    bench.spin_for(0.5)
    bench.deviation, bench.goal = FIRM, bench.pose() + AWAY
    bench.clear()
    noticed = bench.wait(lambda: bench.is_in(ControllerState.DAMPING, "oscillates and does not settle"), "the swings")
    reason = bench.modes.last.reason
    before = float(bench.speeds().max())
    rest = bench.wait(lambda: bench.speed() < AT_REST, "rest")
    bench.clear()
    bench.spin_for(4.0)
    again = float(bench.speeds().max())
    assert again < ORDINARY, f"it swings again, at {again:.2f} of a speed limit"
    bench.spin_for(0.1)
    return (
        f"noticed {noticed:.2f} s after the reference came, at {100 * before:.0f} % of a speed limit ({reason}); at "
        f"rest {rest:.2f} s later, then at most {100 * again:.0f} %: {bench.modes.last.reason}"
    )


@fault(
    LateBench,
    "an arm that is held by up to 60 N on its way",
    "HOLD with the reason once it gets no nearer; when it is let go it goes on gently, to its goal",
    quick=False,
)
def held(bench: LateBench) -> str:
    bench.deviation, start = 5.0 * SOFT, bench.pose()
    bench.goal = start + 2.5 * AWAY
    bench.clear()

    def hold() -> None:
        # no firmer than this: the hand's pose is some 10 ms old
        bench.push(np.clip(-800.0 * (bench.pose() - start)[:3], -60.0, 60.0))

    def noticed() -> bool:
        hold()
        return bench.is_in(ControllerState.HOLD, "not following")

    took = bench.wait(noticed, "HOLD")
    reason = bench.modes.last.reason
    bench.spin_for(1.0, hold)
    bench.clear()
    back = bench.wait(lambda: bench.is_in(ControllerState.ACTIVE), "following again")
    bench.spin_for(2.0)
    fastest = float(bench.speeds().max())
    assert fastest < ORDINARY, f"it leapt, at {fastest:.2f} of a speed limit"
    return (
        f"HOLD after {took:.1f} s ({reason}); let go, ACTIVE after {back:.1f} s, at most {100 * fastest:.0f} % of a "
        f"speed limit, {1e3 * bench.away():.0f} mm from the goal"
    )


@fault(
    LateBench,
    "a reference out of reach",
    "HOLD with the reason: where it stands, and why it gets no further; ACTIVE with the next one that it can follow",
    quick=False,
)
def out_of_reach(bench: LateBench) -> str:
    bench.deviation, bench.goal = SOFT, bench.pose() + np.array([0.8, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    bench.clear()
    took = bench.wait(lambda: bench.is_in(ControllerState.HOLD, "not following"), "HOLD")
    bench.spin_for(3.0)
    reason = bench.modes.last.reason
    last = bench.speed()
    bench.goal = bench.pose() + np.array([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    back = bench.wait(lambda: bench.is_in(ControllerState.ACTIVE), "following again")
    return (
        f"HOLD after {took:.1f} s, at {100 * last:.0f} % of a speed limit ({reason}); the next one: ACTIVE after "
        f"{back:.1f} s"
    )
