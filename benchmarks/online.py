# SPDX-License-Identifier: Apache-2.0
"""Learning that goes on against learning from all demonstrations at once: likelihood, memory, time.

Both start from a few demonstrations. Then `OnlineTPGMM` takes in one after the other, without the former ones; the
batch model is learned anew from all so far. Log-likelihoods are in nats per sample of all demonstrations together;
retained is what the online model knows of its own, without the data, to be a lower bound of it. Memory is the share
of the numbers in the samples of all frames that the cells take. From different starts, either may find the better
maximum.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from benchmarks.report import write_report  # noqa: E402
from tpgmm_core import TPGMM, Demonstration  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.learning.incremental.online import OnlineTPGMM  # noqa: E402
from workloads import W1, demonstrations, pose_demonstrations  # noqa: E402

N_FIRST = 3
CELL_SIZES = (1, 5, 10, 20)
SHOWN = 5  # the cell size in the picture
# Nats per sample that learning one by one may cost, against all demonstrations at once: with cells of up to the default
# size, and with larger ones, which save memory
AS_GOOD, COARSE = 0.5, 1.5
CURVATURE = 0.05  # nats: on the sphere the bound holds up to the curvature over the extent of a cell

WORK: dict[str, tuple[Callable[[int], list[Demonstration]], dict[str, Any]]] = {
    "W1": (lambda seed: demonstrations(W1, seed), {"n_components": 6, "reg_covar": 1e-3}),
    "poses": (
        lambda seed: pose_demonstrations(10, n_samples=100, seed=seed),
        {"n_components": 5, "reg_covar": 1e-3, "manifold": "R1 x R3 x S3"},
    ),
}

Curves = dict[str, np.ndarray]


def compare(work: str, seed: int, cell_size: int) -> tuple[Row, Curves]:
    """One row of the table, and the log-likelihoods over the demonstrations."""
    make, params = WORK[work]
    demos = make(seed)
    params = {**params, "regularization": "prior"}
    online = OnlineTPGMM(**params, cell_size=cell_size, growth_threshold=None).fit(demos[:N_FIRST])
    batch = TPGMM(**params)
    course: dict[str, list[float]] = {"online": [], "batch": [], "retained": []}
    online_s, batch_s = [], []
    for i in range(N_FIRST, len(demos)):
        start = time.perf_counter()
        online.partial_fit([demos[i]])
        online_s.append(time.perf_counter() - start)
        start = time.perf_counter()
        batch.fit(demos[: i + 1])
        batch_s.append(time.perf_counter() - start)
        course["online"].append(online.score(demos[: i + 1]))
        course["retained"].append(online.retained_)
        course["batch"].append(batch.score(demos[: i + 1]))
    tolerance = 1e-9 if online.manifold_.is_euclidean else CURVATURE
    held = sum(m.dim + m.tangent_dim * (m.tangent_dim + 1) // 2 + 1 for m in online.frame_manifolds_.values())
    shown = sum(m.dim for m in online.frame_manifolds_.values())
    row: Row = {
        "work": work,
        "seed": seed,
        "cell_size": cell_size,
        "batch": course["batch"][-1],
        "online": course["online"][-1],
        "retained": course["retained"][-1],
        "memory_share": held * len(online.cells_.counts) / (shown * sum(len(demo.times) for demo in demos)),
        "online_ms": 1e3 * float(np.median(online_s)),
        "batch_ms": 1e3 * float(np.median(batch_s)),
        "passed": bool(np.all(np.array(course["retained"]) <= np.array(course["online"]) + tolerance))
        and course["online"][-1] >= course["batch"][-1] - (AS_GOOD if cell_size <= SHOWN else COARSE),
    }
    return row, {name: np.array(values) for name, values in course.items()}


def draw(courses: dict[tuple[str, int], Curves], path: Path) -> None:
    """Log-likelihoods over the demonstrations taken in, a panel for each work."""
    figure = Figure(figsize=(5.0 * len(WORK), 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    for i, work in enumerate(WORK):
        axes = figure.add_subplot(1, len(WORK), i + 1)
        for (name, seed), course in courses.items():
            if name != work:
                continue
            numbers = N_FIRST + 1 + np.arange(len(course["online"]))
            style = ("-", "--", ":", "-.")[seed % 4]
            for kind, colour, width in (
                ("batch", "black", 1.0),
                ("online", "tab:blue", 2.5),
                ("retained", "orange", 1.0),
            ):
                label = f"{kind}, data {seed}"
                axes.plot(numbers, course[kind], color=colour, linewidth=width, linestyle=style, label=label)
        axes.set_xlabel("demonstrations taken in")
        axes.set_ylabel("log-likelihood per sample")
        axes.set_title(f"{work}, {SHOWN} samples in a cell")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(frameon=False)
    figure.savefig(path, dpi=120)


def main(arguments: list[str] | None = None) -> int:
    """Returns 1 when a bound did not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2, help="random data sets of each kind (2)")
    parser.add_argument("--output", type=Path, default=Path("out/online"), help="directory (out/online)")
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    courses: dict[tuple[str, int], Curves] = {}
    for work in WORK:
        for seed in range(options.seeds):
            for cell_size in CELL_SIZES:
                row, course = compare(work, seed, cell_size)
                rows.append(row)
                if cell_size == SHOWN:
                    courses[work, seed] = course
    status = write_report("report", rows, options.output)
    draw(courses, options.output / "online.png")
    return status


if __name__ == "__main__":
    sys.exit(main())
