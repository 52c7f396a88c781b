# SPDX-License-Identifier: Apache-2.0
"""Each robot does the pick-and-place task, by its own interface; prints a table and writes report.json.

The nodes are those that loop.launch.py starts, with files of config/. In place of each robot there is a process that
checks what it is told: types, order of joints, limits, pauses, and what happens at the end.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from interfaces.cases import CASES
from interfaces.run import Conditions, run
from tpgmm_core.common.report import format_table
from tpgmm_ros.programs import train
from tpgmm_ros.programs.reporting import run_with_report, write_report
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY, GraphError
from tpgmm_ros.runtime.resources import config_file

BAGS = Path("bags/pick_place")
COLUMNS = ("robot", "interface", "error", "commands", "longest gap", "after the end", "violations", "passed")


def main() -> int:
    parser = argparse.ArgumentParser(prog="interfaces", description=__doc__)
    parser.add_argument(
        "names", nargs="*", help=f"only these robots, of {', '.join(case.name for case in CASES)} (default: all)"
    )
    parser.add_argument("--seed", type=int, default=1, help="number of the situation (default: %(default)s)")
    parser.add_argument(
        "--rate", type=float, default=1000.0, help="joint states and torques of the Panda, Hz (default: %(default)g)"
    )
    parser.add_argument(
        "--priority", type=int, default=REALTIME_PRIORITY, help="of the nodes; 0: none (default: %(default)s)"
    )
    parser.add_argument(
        "--slower", type=float, default=0.0,
        help="on simulated time, so many times slower than real time, for busy machines; the Panda's simulator then "
        "waits for each answer (default: in real time)",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, default=Path("out/robots"), help="report and logs (default: %(default)s)"
    )
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - {case.name for case in CASES}:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; expected some of {', '.join(c.name for c in CASES)}")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # which ends the nodes too
    return run_with_report(arguments.output, lambda: _run(arguments), (GraphError,))


def _run(arguments: argparse.Namespace) -> bool:
    model = arguments.output / "pick_place.tpgmm"
    if not model.exists() and train.main(
        ["--task", str(config_file("pick_place.yaml")), "--output", str(model), str(BAGS)]
    ):
        raise GraphError("training failed")
    conditions = Conditions(
        seed=arguments.seed, rate=arguments.rate, slower=arguments.slower,
        priority=0 if arguments.slower else arguments.priority,
    )  # fmt: skip
    rows = []
    for case in CASES:
        if arguments.names and case.name not in arguments.names:
            continue
        print(f"{case.name}: {case.interface}", flush=True)
        try:
            row = run(case, model, arguments.output / case.name, conditions)
        except GraphError as error:
            row = {"robot": case.name, "interface": case.interface, "passed": False, "error": str(error)}
        rows.append(row)
    given = {"load": os.getloadavg()[0], "seed": arguments.seed, "rate_hz": arguments.rate, "slower": arguments.slower}
    path = write_report(arguments.output, given | {"robots": rows})
    print(format_table(COLUMNS, [_cells(row) for row in rows]))
    for row in rows:
        for text in [*row.get("examples", {}).values(), *([row["error"]] if "error" in row else [])]:
            print(f"{row['robot']}: {text}")
    print(f"report: {path}")
    return all(row["passed"] for row in rows)


def _cells(row: dict) -> tuple[str, ...]:
    if "error" in row:
        return row["robot"], row["interface"], *(("",) * 5), "NO"
    broken = ", ".join(f"{kind} ({count})" for kind, count in row["violations"].items()) or "none"
    measured = f"{row['error_mm']:.1f} mm", str(row["commands"]), f"{row['longest_gap_ms']:.0f} ms"
    verdict = "yes" if row["passed"] else "NO"
    return row["robot"], row["interface"], *measured, f"{row['after_the_end_mm']:.2f} mm", broken, verdict


if __name__ == "__main__":
    sys.exit(main())
