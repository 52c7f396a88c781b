# SPDX-License-Identifier: Apache-2.0
"""The demo in lockstep, twice: equal, bit by bit? And how fast compared with real time? out/determinism/report.json"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from tpgmm_ros.reporting import format_table, write_report


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the demo's situation (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("out/determinism"), help="(default: %(default)s)")
    arguments = parser.parse_args()
    (arguments.output / "report.json").unlink(missing_ok=True)
    runs = []
    for i in (1, 2):
        output = arguments.output / f"run_{i}"
        command = [sys.executable, "-m", "tpgmm_ros.demo", "--lockstep", "--seed", str(arguments.seed)]
        subprocess.run([*command, "--output", str(output)], check=True, stdout=subprocess.DEVNULL)
        runs.append(json.loads((output / "report.json").read_text()))
    report = {
        "passed": runs[0]["digest"] == runs[1]["digest"],
        "digests": [run["digest"] for run in runs],
        "real_time_factor": max(run["real_time_factor"] for run in runs),
    }
    print(format_table(("what", "value"), [(key, str(value)) for key, value in report.items()]))
    print(f"report: {write_report(arguments.output, report)}")
    return 0 if report["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
