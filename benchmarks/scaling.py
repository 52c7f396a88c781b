# SPDX-License-Identifier: Apache-2.0
"""Time and memory of EM against samples, components and frames: each should grow in proportion.

From a base of 10 000 samples, 4 components and 2 frames of 4 dimensions, one number grows at a time. Time is that of
one iteration (the median of some fits of ten iterations each); memory is the most that a fit holds beyond the data
that it was given, by a process of its own. An exponent of 1 means linear, and less that something fixed still shows.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from benchmarks.report import write_report  # noqa: E402
from tpgmm_core import TPGMM  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402

ITERATIONS = 10


@dataclass(frozen=True)
class Size:
    """Samples N, components K, frames P of D dimensions."""

    N: int = 10_000
    K: int = 4
    P: int = 2
    D: int = 4


@dataclass(frozen=True)
class Cost:
    """Of one fit: time of an iteration, s; memory beyond the data, bytes; the data, bytes."""

    iteration_s: float
    memory: int
    data: int


def samples(size: Size) -> dict[str, Array]:
    """Movements along random bends, the first dimension being time."""
    rng = np.random.default_rng(0)
    phase = np.linspace(0.0, 1.0, size.N)
    X = {}
    for j in range(size.P):
        x = np.empty((size.N, size.D))
        x[:, 0] = phase
        for i in range(1, size.D):
            x[:, i] = np.sin(2.0 * np.pi * (rng.uniform(0.2, 2.0) * phase + rng.uniform()))
            x[:, i] += 0.05 * rng.standard_normal(size.N)
        X[f"frame_{j}"] = x
    return X


def cost(size: Size, covariance: str, n_fits: int) -> Cost:
    """Cost of fits of this size; meant for a process of its own, whose peak memory then is that of the fit."""
    TPGMM(size.K, max_iter=2, covariance=covariance, n_factors=2).fit_projected(samples(replace(size, N=500)))
    X = samples(size)
    model = TPGMM(size.K, tol=0.0, max_iter=ITERATIONS, covariance=covariance, n_factors=2)
    before = _resident()
    times = []
    for _ in range(n_fits):
        stamps: list[float] = []

        def stamp(iteration: int, log_likelihood: float, stamps: list[float] = stamps) -> None:
            stamps.append(time.perf_counter())

        model.fit_projected(X, progress=stamp)
        times.append((stamps[-1] - stamps[0]) / (len(stamps) - 1))
    return Cost(float(np.median(times)), _peak() - before, sum(x.nbytes for x in X.values()))


def _resident() -> int:
    """Bytes of this process that are in memory; the peak starts again from here."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _peak() -> int:
    return _status("VmHWM")


def _status(key: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return 1024 * int(line.split()[1])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/scaling"), help="of report.json and scaling.png")
    parser.add_argument(
        "--max-samples", type=float, default=1e6, help="up to which N grows from 1000 (default: %(default)g)"
    )
    parser.add_argument("--structures", nargs="+", default=["full", "mfa"], help="(default: %(default)s)")
    parser.add_argument("--fits", type=int, default=3, help="for each size (default: %(default)s)")
    options = parser.parse_args(arguments)
    n = round(2.0 * np.log10(options.max_samples / 1e3)) + 1
    courses = {
        "samples": [Size(N=round(N)) for N in np.geomspace(1e3, options.max_samples, n)],
        "components": [Size(K=K) for K in (1, 2, 4, 8, 16, 32)],
        "frames": [Size(P=P) for P in (1, 2, 4, 8, 16)],
    }
    rows = []
    context = get_context("spawn")  # a fresh process for each: peaks of memory do not add up
    for covariance in options.structures:
        for course, sizes in courses.items():
            for size in sizes:
                with ProcessPoolExecutor(1, mp_context=context) as process:
                    found = process.submit(cost, size, covariance, options.fits).result()
                rows.append(
                    {
                        "structure": covariance,
                        "course": course,
                        "samples": size.N,
                        "components": size.K,
                        "frames": size.P,
                        "iteration_ms": 1e3 * found.iteration_s,
                        "data_mb": found.data / 1e6,
                        "memory_mb": found.memory / 1e6,
                    }
                )
                print(f"{covariance}, {size}: {1e3 * found.iteration_s:.3g} ms", file=sys.stderr)
    write_report("report", rows, options.output)
    _picture(rows, options.structures, options.output / "scaling.png")
    print(f"picture: {options.output / 'scaling.png'}")
    return 0


def _picture(rows: Sequence[Mapping[str, Any]], structures: Sequence[str], path: Path) -> None:
    figure = Figure(figsize=(15.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 4)
    for axes, (course, key, label) in zip(
        panels,
        [
            ("samples", "iteration_ms", "time of an iteration / ms"),
            ("samples", "memory_mb", "memory beyond the data / MB"),
            ("components", "iteration_ms", "time of an iteration / ms"),
            ("frames", "iteration_ms", "time of an iteration / ms"),
        ],
        strict=True,
    ):
        for structure in structures:
            chosen = [row for row in rows if row["structure"] == structure and row["course"] == course]
            x, y = np.array([(row[course], max(row[key], 1e-3)) for row in chosen]).T
            half = len(x) // 2
            exponent = np.polyfit(np.log(x[half:]), np.log(y[half:]), 1)[0]
            axes.loglog(x, y, marker="o", markersize=4, label=f"{structure}, exponent {exponent:.2f}")
        if key == "memory_mb":
            data = [row for row in rows if row["structure"] == structures[0] and row["course"] == course]
            axes.loglog(x, [row["data_mb"] for row in data], "k--", linewidth=0.8, label="the data")
        axes.set_xlabel(course)
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    sys.exit(main())
