# SPDX-License-Identifier: Apache-2.0
"""Whether the demo in lockstep gives the same twice, bit by bit, and how fast it is compared with real time.

All nodes, as processes of their own; the robot's dynamics are computed at 1 kHz at least, whatever the rate of joint
states, references and torques. Writes out/determinism/report.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from tpgmm_core.common.report import format_table
from tpgmm_ros.programs.reporting import write_report

RATES = (1000.0, 500.0)


def main() -> int:
    """Run it; returns the exit status, 0 where all runs are equal."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the demo's situation (default: %(default)s)")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES, help="Hz (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("out/determinism"), help="(default: %(default)s)")
    arguments = parser.parse_args()
    (arguments.output / "report.json").unlink(missing_ok=True)
    rows = [row(rate, arguments.seed, arguments.output) for rate in arguments.rates]
    keys = ("rate_hz", "equal", "real_time_factor", "movement_time_s")
    print(format_table(keys, [tuple(f"{item[key]:g}" for key in keys) for item in rows]))
    passed = all(item["equal"] for item in rows)
    print(f"report: {write_report(arguments.output, {'passed': passed, 'rates': rows})}")
    return 0 if passed else 1


def row(rate: float, seed: int, output: Path) -> dict[str, float | bool | list[str]]:
    """Two runs at a rate, Hz; the better of their factors, since other programs only ever slow them down."""
    runs = []
    for i in (1, 2):
        directory = output / f"{rate:g}_hz_{i}"
        command = [sys.executable, "-m", "tpgmm_demos.demo", "--lockstep", "--rate", str(rate), "--seed", str(seed)]
        subprocess.run([*command, "--output", str(directory)], check=True, stdout=subprocess.DEVNULL)
        runs.append(json.loads((directory / "report.json").read_text()))
    digests = [run["digest"] for run in runs]
    return {
        "rate_hz": rate,
        "equal": digests[0] == digests[1],
        "digests": digests,
        "real_time_factor": max(run["real_time_factor"] for run in runs),
        "movement_time_s": runs[0]["movement_time_s"],
    }


if __name__ == "__main__":
    sys.exit(main())
