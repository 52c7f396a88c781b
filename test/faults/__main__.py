# SPDX-License-Identifier: Apache-2.0
"""Make every fault happen, print the table and write report.json: what was promised, and what was observed."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import time
from pathlib import Path

from faults.graph_bench import GraphBench
from faults.table import Benches, Fault, all_faults
from tpgmm_core.common.report import format_table
from tpgmm_ros.programs.reporting import write_report


def main() -> int:
    parser = argparse.ArgumentParser(prog="faults", description=__doc__)
    parser.add_argument("names", nargs="*", help="only faults whose names contain one of these (default: all)")
    parser.add_argument(
        "--output", type=Path, default=Path("out/faults"), help="report and logs (default: %(default)s)"
    )
    parser.add_argument(
        "--rate", type=float, default=GraphBench.joint_state_rate, metavar="HZ",
        help="joint states per second where all nodes run in real time: less on slow cores (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument("--list", action="store_true", help="print names and promises, and do nothing")
    arguments = parser.parse_args()
    faults = [row for row in all_faults() if not arguments.names or any(name in row.name for name in arguments.names)]
    if arguments.list:
        print(format_table(("fault", "promise"), [(row.name, row.promise) for row in faults]))
        return 0
    GraphBench.joint_state_rate = arguments.rate
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, joint states at {arguments.rate:g} Hz")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # which ends the nodes too
    # A report of an earlier success must not stand beside a failure
    (arguments.output / "report.json").unlink(missing_ok=True)
    rows = _run(faults, arguments.output / "log")
    path = write_report(arguments.output, rows)
    print(format_table(("fault", "kept"), [(row["name"], "yes" if row["passed"] else "NO") for row in rows]))
    kept = sum(bool(row["passed"]) for row in rows)
    print(f"{kept} of {len(rows)} promises were kept; report: {path}")
    return 0 if kept == len(rows) > 0 else 1


def _run(faults: list[Fault], directory: Path) -> list[dict[str, object]]:
    benches = Benches(directory)
    directory.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, object]] = []
    with (directory / "processes.log").open("w") as log, contextlib.ExitStack() as stack:

        @stack.callback
        def end() -> None:
            with contextlib.redirect_stdout(log):
                benches.close()

        for number, row in enumerate(faults, 1):
            began = time.monotonic()
            passed = False
            with contextlib.redirect_stdout(log):  # what the nodes say
                try:
                    observed = benches.run(row)
                    passed = True
                except Exception as error:
                    observed = f"{type(error).__name__}: {error}"
            rows.append({"name": row.name, "promise": row.promise, "observed": observed, "passed": passed})
            verdict = "kept" if passed else "NOT KEPT"
            print(f"{number}/{len(faults)} {row.name} ({time.monotonic() - began:.1f} s)\n    {verdict}: {observed}")
    return rows


if __name__ == "__main__":
    sys.exit(main())
