# SPDX-License-Identifier: Apache-2.0
"""EM over more samples than are to be in the memory at once: `TPGMM.fit_parts`, from 10^5 to 10^7 samples.

Parts of 50 000 samples are made anew each time that they are gone through. Each size runs in a process of its own;
memory is the largest part of it that was in memory, above what the imports and a small fit take.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.recordings import peak_kb
from benchmarks.report import write_report
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.report import Row

PART = 50_000
MOST_MB = 32.0
"""By which the memory may grow from the fewest samples to the most."""


@dataclass(frozen=True)
class Parts:
    """Movements in the plane between two frames, one demonstration in each part."""

    n_samples: int

    def __iter__(self) -> Iterator[Sequence[Demonstration]]:
        for number in range(self.n_samples // PART):
            rng = np.random.default_rng(number)
            s = np.linspace(0.0, 1.0, PART)[:, None]
            begin, end = rng.normal(0.0, 0.3, (2, 2))
            data = np.hstack([s, begin + s * (end - begin) + rng.normal(0.0, 0.02, (PART, 2))])
            frames = {name: Frame(np.eye(3), np.array([0.0, *at])) for name, at in (("object", begin), ("target", end))}
            yield [Demonstration(s[:, 0], data, frames)]


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=float, nargs="+", default=[1e5, 1e6, 1e7], help="(default: 1e5 1e6 1e7)")
    parser.add_argument("--iterations", type=int, default=6, help="of EM (default: 6)")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one is not None:
        TPGMM(4, max_iter=2).fit_parts(Parts(PART))
        before, begin = peak_kb(), time.perf_counter()
        model = TPGMM(4, tol=0.0, max_iter=options.iterations).fit_parts(Parts(options.one))
        print(time.perf_counter() - begin, (peak_kb() - before) / 1024.0, model.log_likelihood_)
        return 0
    rows: list[Row] = []
    peaks = []
    for samples in sorted(map(int, options.samples)):
        command = [sys.executable, __file__, "--one", str(samples), "--iterations", str(options.iterations)]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds, megabytes, log_likelihood = map(float, run.stdout.split())
        peaks.append(megabytes)
        rows.append({"samples": samples, "s": seconds, "peak MB": megabytes, "log-likelihood": log_likelihood})
    grown = peaks[-1] - peaks[0]
    rows.append({"samples": "growth", "peak MB": grown, "to reach": MOST_MB, "passed": grown <= MOST_MB})
    keys = dict.fromkeys(key for row in rows for key in row)
    return write_report("parted_em", [{key: row.get(key) for key in keys} for row in rows])


if __name__ == "__main__":
    sys.exit(main())
