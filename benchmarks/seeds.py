# SPDX-License-Identifier: Apache-2.0
"""The demo in lockstep for many seeds: each is a situation of its own, with pushes, hidden frames and noise of its own.

One model is trained for all of them. Prints a table, and the cause where a seed failed; writes out/seeds/report.json,
after each seed, and beside it what its demo leaves. Status 0 only if every seed passed, 130 if it was interrupted.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import one_line
from tpgmm_demos.scene.perception import PERCEPTIONS
from tpgmm_ros.programs import train
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.runtime.entry import INTERRUPTED
from tpgmm_ros.runtime.resources import config_file

TASK_FILE = config_file("pick_place.yaml")
BAGS = Path("bags/pick_place")
#: For one seed, s: on a machine with two free cores it takes half a minute.
TIMEOUT = 900.0
HEADER = ("seed", "passed", "position, mm", "orientation, deg", "outcome", "cause")


def seeds_of(text: str) -> list[int]:
    """Numbers and ranges, separated by commas: "3,1001-1030"."""
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:-(\d+))?\s*", part)
        if match is None:
            raise argparse.ArgumentTypeError(f"'{part}': give numbers and ranges, such as 3,1001-1030")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise argparse.ArgumentTypeError(f"'{part}': the range ends before it begins")
        seeds += range(first, last + 1)
    return list(dict.fromkeys(seeds))


def main() -> int:
    """Run the demo for each seed and print the table; returns the exit status, 0 where all passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shown = "(default: %(default)s)"
    parser.add_argument("--seeds", type=seeds_of, default="1001-1030", help=f"numbers and ranges {shown}")
    parser.add_argument("--model", type=Path, help="a model file to use, in place of training one")
    parser.add_argument("--perception", choices=PERCEPTIONS, default="camera", help=f"see demo --help {shown}")
    parser.add_argument("--rate", type=float, default=1000.0, help=f"of joint states and torques, Hz {shown}")
    parser.add_argument("--output", type=Path, default=Path("out/seeds"), help=f"reports, model, pictures {shown}")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    try:
        return _run(arguments, rows)
    except KeyboardInterrupt:
        error, status = "interrupted", INTERRUPTED
    except (OSError, TrainingError) as reason:
        error, status = one_line(reason), 1
    print(f"error: {error}", file=sys.stderr)
    if rows:
        print(table(rows))
    print(f"report: {_report(arguments, rows, error)}")
    return status


class TrainingError(Exception):
    """No model was trained; the reason was printed."""


def _run(arguments: argparse.Namespace, rows: list[dict[str, Any]]) -> int:
    """All seeds; their results are added to `rows` as they come."""
    (arguments.output / "report.json").unlink(missing_ok=True)
    model = arguments.model or arguments.output / "pick_place.tpgmm"
    if arguments.model is None:
        status = train.main(["--task", str(TASK_FILE), "--output", str(model), str(BAGS)])
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        if status:
            raise TrainingError("training failed")
    begun = time.monotonic()
    for seed in arguments.seeds:
        rows.append(run(seed, model, arguments.perception, arguments.output / str(seed), arguments.rate))
        verdict = "passed" if rows[-1]["passed"] else f"FAILED: {rows[-1]['cause']}"
        minutes = (time.monotonic() - begun) / 60.0
        print(f"seed {seed} ({len(rows)} of {len(arguments.seeds)}, {minutes:.1f} min): {verdict}", flush=True)
        path = _report(arguments, rows)  # after each: who ends this early keeps what is known
    failed = _failed(rows)
    print(table(rows))
    print(f"{len(rows) - len(failed)} of {len(rows)} seeds passed" + (f"; failed: {failed}" if failed else ""))
    print(f"report: {path}")
    return 1 if failed else 0


def _failed(rows: list[dict[str, Any]]) -> list[int]:
    return [row["seed"] for row in rows if not row["passed"]]


def _report(arguments: argparse.Namespace, rows: list[dict[str, Any]], error: str = "") -> Path:
    failed = _failed(rows)
    passed = not failed and not error and len(rows) == len(arguments.seeds)
    report = {"passed": passed, "error": error, "rate_hz": arguments.rate, "failed": failed, "seeds": rows}
    return write_report(arguments.output, report)


def run(seed: int, model: Path, perceived: str, output: Path, rate: float = 1000.0) -> dict[str, Any]:
    """One demo in a process of its own, at a rate in Hz; what came of it."""
    command = [sys.executable, "-m", "tpgmm_demos.demo", "--lockstep", "--seed", str(seed), "--model", str(model)]
    command += ["--perception", perceived, "--rate", str(rate), "--output", str(output)]
    said = ""
    (output / "report.json").unlink(missing_ok=True)
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
        said = ended.stderr.strip()
        report = json.loads((output / "report.json").read_text())
    except subprocess.TimeoutExpired:
        report = {"passed": False, "error": f"not done in {TIMEOUT:g} s"}
    except FileNotFoundError:
        report = {"passed": False, "error": f"the demo left no report: {said}"}
    return {
        "seed": seed,
        "passed": report["passed"],
        "final_position_error_m": report.get("final_position_error_m"),
        "final_orientation_error_deg": report.get("final_orientation_error_deg"),
        "torque_jump_when_frame_lost_nm": report.get("torque_jump_when_frame_lost_nm"),
        "torque_jump_when_frame_back_nm": report.get("torque_jump_when_frame_back_nm"),
        "largest_torque_jump_nm": report.get("largest_torque_jump_nm"),
        "outcome": report.get("outcome", ""),
        "cause": " ".join(filter(None, (report.get("error"), report.get("cause")))),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """The results for people."""

    def cells(row: dict[str, Any]) -> tuple[str, ...]:
        position, orientation = row["final_position_error_m"], row["final_orientation_error_deg"]
        return (
            str(row["seed"]),
            "yes" if row["passed"] else "NO",
            "-" if position is None else f"{1e3 * position:.2f}",
            "-" if orientation is None else f"{orientation:.2f}",
            row["outcome"],
            row["cause"],
        )

    return format_table(HEADER, [cells(row) for row in rows])


if __name__ == "__main__":
    sys.exit(main())
