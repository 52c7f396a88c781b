# SPDX-License-Identifier: Apache-2.0
"""The demo as a whole, on simulated time; and that a failure never leaves a report of success."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from ros_graph import ROOT
from ros_testing import executable

#: The keys that programs rely on, and their types
REPORT: dict[str, Any] = {
    "passed": bool,
    "final_position_error_m": float,
    "final_orientation_error_deg": float,
    "path_deviation_m": float,
    "max_torque_share": float,
    "torque_jump_when_frame_lost_nm": float,
    "torque_jump_when_frame_back_nm": float,
    "largest_torque_jump_nm": float,
    "ticks": {
        node: {"asked": int, "done": int} for node in ("reproduction", "impedance_controller", "baxter_simulator")
    },
    "reproduction_step_ms": {"p50": float, "p99": float},
    "torque_age_ms": {"p50": float, "p99": float},
    "perception": {"kind": str, "camera_hz": float, "rate_hz": {"object": float, "target": float}},
    "nearest_to_grasp": {"m": float, "rad": float},
    "saturated_joints": list,
    "load": float,
    "cores": int,
    "cause": str,
}


def run_demo(output: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [executable("demo"), "--output", str(output), *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[subprocess.CompletedProcess[str], Path]]:
    """One run of the demo in lockstep, and where it wrote to."""
    output = tmp_path_factory.mktemp("demo")
    run = run_demo(output, "--lockstep", "--seed", "7")
    yield run, output
    print(run.stdout, run.stderr)


def assert_has(values: dict[str, Any], keys: dict[str, Any]) -> None:
    for key, kind in keys.items():
        if isinstance(kind, dict):
            assert_has(values[key], kind)
        else:
            assert type(values[key]) in ((int, float) if kind is float else (kind,)), key


def test_the_demo_achieves_the_task_and_ends_with_status_0(
    demo: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    run, output = demo
    assert run.returncode == 0, run.stdout + run.stderr
    assert "final position error" in run.stdout and str(output) in run.stdout


def test_the_report_has_all_its_keys_in_plain_numbers_within_what_is_to_be_reached(
    demo: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    report = json.loads((demo[1] / "report.json").read_text())
    assert_has(report, REPORT)
    assert report["passed"] is True
    assert report["final_position_error_m"] <= 0.01 and report["final_orientation_error_deg"] <= 5.0
    assert 0.0 < report["max_torque_share"] <= 1.0
    assert report["torque_jump_when_frame_lost_nm"] <= 0.5 and report["torque_jump_when_frame_back_nm"] <= 0.5
    assert report["cause"] == "" and report["perception"]["kind"] == "camera"
    for frame, rate in report["perception"]["rate_hz"].items():
        assert 0.9 * 30.0 < rate < 1.1 * 30.0, frame
    for ticks in report["ticks"].values():
        assert 0 < ticks["done"] <= ticks["asked"]


@pytest.mark.parametrize("name", ["path.png", "torques.png", "frames.png"])
def test_the_pictures_show_something(demo: tuple[subprocess.CompletedProcess[str], Path], name: str) -> None:
    picture = matplotlib.image.imread(demo[1] / name)
    assert picture.shape[0] > 300 and picture.shape[1] > 600
    colors = np.unique((255 * picture[..., :3]).astype(np.uint8).reshape(-1, 3), axis=0)
    assert len(colors) > 200
    assert picture[..., :3].std() > 0.05


def test_a_model_that_is_given_is_used_and_one_that_is_none_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "model.tpgmm").write_text("no model")
    run = run_demo(tmp_path / "out", "--model", str(tmp_path / "model.tpgmm"))
    assert run.returncode == 1 and "model.tpgmm" in run.stderr and "Traceback" not in run.stderr
    assert "training" not in run.stdout
    assert json.loads((tmp_path / "out" / "report.json").read_text())["passed"] is False


def test_a_failed_demo_says_why_and_leaves_no_report_of_an_earlier_success(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text('{"passed": true}')
    run = run_demo(tmp_path, "--bags", str(tmp_path / "nowhere"))
    assert run.returncode == 1
    assert "nowhere" in run.stderr and "Traceback" not in run.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["passed"] is False and report["error"]
