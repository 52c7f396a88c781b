# SPDX-License-Identifier: Apache-2.0
"""Why a run of the demo failed: what is said, with which figures, and when nothing is."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from tpgmm_demos.demo.causes import cause_of_failure, machine_figures

#: Of a run in which the machine kept up and all went well.
GOOD: dict[str, Any] = {
    "passed": True,
    "lockstep": False,
    "ticks": {
        "reproduction": {"asked": 11000, "done": 10950},
        "impedance_controller": {"asked": 11000, "done": 10960},
        "baxter_simulator": {"asked": 11000, "done": 10980},
    },
    "torque_age_ms": {"p50": 1.0, "p99": 2.2},
    "perception": {"camera_hz": 30.0, "rate_hz": {"object": 29.7, "target": 29.9}},
    "nearest_to_grasp": {"m": 0.002, "rad": 0.02},
    "saturated_joints": [],
    "load": 5.3,
    "cores": 2,
    "outcome": "0.2 mm and 0.1 deg from the end of the movement",
    "reference_speed_m_s": {"largest": 0.4, "at_s": 6.8, "mean": 0.2},
    "checks": {
        "the object was grasped": True,
        "the movement ended well": True,
        "the object is on the target": True,
        "no jump when a frame was lost": True,
        "no jump when it came back": True,
    },
}


def run_with(failed: str = "the object was grasped", **changes: Any) -> dict[str, Any]:
    """A failed run that differs from the good one in some figures."""
    report = copy.deepcopy(GOOD) | changes | {"passed": False}
    report["checks"][failed] = False
    return report


def test_a_run_that_passed_has_no_cause_though_the_machine_was_late() -> None:
    assert cause_of_failure(GOOD | {"torque_age_ms": {"p50": 1.0, "p99": 50.0}}) == ""


@pytest.mark.parametrize("share", [0.02, 0.05, 0.5])
@pytest.mark.parametrize("node", ["reproduction", "impedance_controller", "baxter_simulator"])
def test_lost_ticks_are_named_with_node_and_share_and_lockstep_is_offered(node: str, share: float) -> None:
    ticks = copy.deepcopy(GOOD["ticks"])
    ticks[node]["done"] = round(11000 * (1.0 - share))
    cause = cause_of_failure(run_with(ticks=ticks))
    assert "too slow" in cause and "--lockstep" in cause
    assert f"{node} lost {11000 - ticks[node]['done']} of 11000 ticks ({100 * share:.1f} %" in cause
    assert "5.3 programs were ready to run on 2 cores" in cause
    assert all(other not in cause for other in ticks if other != node)


def test_a_node_that_says_nothing_of_its_ticks_starves_too() -> None:
    silent = copy.deepcopy(GOOD["ticks"]) | {"impedance_controller": {"asked": 0, "done": 0}}
    cause = cause_of_failure(run_with(ticks=silent))
    assert "impedance_controller was too busy" in cause and "--lockstep" in cause


def test_old_torques_and_starving_perception_are_named_with_their_figures() -> None:
    cause = cause_of_failure(run_with(torque_age_ms={"p50": 2.0, "p99": 31.4}))
    assert "31.4 ms" in cause and "--lockstep" in cause and "ticks" not in cause
    starved = {"camera_hz": 30.0, "rate_hz": {"object": 11.2, "target": 29.9}}
    cause = cause_of_failure(run_with(perception=starved))
    assert "'object' 11 poses per second" in cause and "'target'" not in cause and "--lockstep" in cause


def test_in_lockstep_the_machine_is_never_to_blame() -> None:
    ticks = {"reproduction": {"asked": 100, "done": 10}}
    report = run_with(lockstep=True, ticks=ticks, torque_age_ms={"p50": 1.0, "p99": 90.0})
    assert machine_figures(report) == []
    assert "too slow" not in cause_of_failure(report)


def test_where_the_machine_kept_up_the_cause_is_what_the_robot_did() -> None:
    cause = cause_of_failure(run_with(nearest_to_grasp={"m": 0.0312, "rad": 0.0}))
    assert "too slow" not in cause and "31.2 mm" in cause and "within 15 mm" in cause
    cause = cause_of_failure(
        run_with("the movement ended well", outcome="155.3 mm from the end", saturated_joints=["left_w1"])
    )
    assert "155.3 mm from the end" in cause and "left_w1" in cause


def test_there_is_always_something_to_go_by() -> None:
    cause = cause_of_failure(run_with("the object is on the target"))
    assert "'the object is on the target'" in cause and "logs" in cause


def test_a_reference_that_is_fast_of_itself_is_named_where_torques_jumped() -> None:
    fast = {"largest": 1.27, "at_s": 7.39, "mean": 0.16}
    jumped = cause_of_failure(run_with("no jump when a frame was lost", reference_speed_m_s=fast))
    assert "1.27 m/s after 7.4 s, 8 times its mean speed" in jumped and "pictures" not in jumped
    assert "m/s" not in cause_of_failure(run_with("the object is on the target", reference_speed_m_s=fast))
    assert "m/s" not in cause_of_failure(run_with("no jump when it came back"))
