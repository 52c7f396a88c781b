# SPDX-License-Identifier: Apache-2.0
"""Memory and time of `train` with and without `--one-by-one`, as recordings become more: copies of one.

Bags are made in a temporary folder, and removed. Each size runs in a process of its own; memory is the largest part of
it that was in memory, above what the imports take. --largest says up to which size the ordinary way is tried. With
few poses --each, what grows with the number of recordings shows soon: 10^7 samples in 1000 of 10 000 take long.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.recordings import TASK, peak_kb, write_bag
from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.programs import train

SAMPLES = 10_000
"""Of a recording, if --each does not say otherwise; as many poses are of the object."""
SETTINGS = "model: {n_components: 3, init: time, max_iter: 5, reg_covar: 1.0e-4}\n"
KB_A_RECORDING = 64.0
"""By which the memory may grow with each recording: outlines, and what is known of a bag."""


def _train(bags: Path, task: Path, more: list[str]) -> None:
    before, begin = peak_kb(), time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
        given = ["--task", str(task), "--output", str(task.with_suffix(".tpgmm")), *more, "--separate", str(bags)]
        if train.main(given):
            raise RuntimeError(said.getvalue()[-500:])
    print(time.perf_counter() - begin, (peak_kb() - before) / 1024.0)


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=float, nargs="+", default=[1e5, 1e6, 1e7], help="(default: 1e5 1e6 1e7)")
    parser.add_argument("--each", type=int, default=SAMPLES, help=f"samples of a recording (default: {SAMPLES})")
    parser.add_argument("--largest", type=float, default=1e6, help="for the ordinary way (default: 1e6)")
    parser.add_argument("--run", nargs="+", type=Path, metavar=("BAGS", "TASK"), help=argparse.SUPPRESS)
    parser.add_argument("--one-by-one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run is not None:
        _train(options.run[0], options.run[1], ["--one-by-one"] if options.one_by_one else [])
        return 0
    rows: list[Row] = []
    peaks: list[tuple[int, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        task, bags = Path(folder) / "task.yaml", Path(folder) / "bags"
        task.write_text(TASK + SETTINGS)
        write_bag(bags / "demo_0", 2 * options.each)
        for count in sorted(max(1, round(samples / options.each)) for samples in options.samples):
            for number in range(len(list(bags.iterdir())), count):
                shutil.copytree(bags / "demo_0", bags / f"demo_{number}")
            for way in [[], ["--one-by-one"]] if count * options.each <= options.largest else [["--one-by-one"]]:
                command = [sys.executable, __file__, *way, "--run", str(bags), str(task)]
                run = subprocess.run(command, capture_output=True, text=True)
                if run.returncode:
                    raise RuntimeError(run.stderr)
                seconds, megabytes = map(float, run.stdout.split())
                if way:
                    peaks.append((count, megabytes))
                name, samples = "one by one" if way else "all at once", count * options.each
                rows.append(
                    {
                        "way": name,
                        "recordings": count,
                        "samples": samples,
                        "s": seconds,
                        "peak MB": megabytes,
                    }
                )
    grown, allowed = peaks[-1][1] - peaks[0][1], (peaks[-1][0] - peaks[0][0]) * KB_A_RECORDING / 1024.0
    rows.append({"way": "growth, one by one", "peak MB": grown, "to reach": allowed, "passed": grown <= allowed})
    keys = dict.fromkeys(key for row in rows for key in row)
    return write_report("one_by_one", [{key: row.get(key) for key in keys} for row in rows])


if __name__ == "__main__":
    sys.exit(main())
