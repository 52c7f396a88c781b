# SPDX-License-Identifier: Apache-2.0
"""EM to convergence: TPGMM by one thread and by two, against careful vectorised numpy of one thread.

Beside the times stands how far an iteration is from what a core can do: the floating-point operations of the equations
per second, as a share of those of a large matrix product, which is as fast as a core gets.
"""

from __future__ import annotations

import os
from functools import partial

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import sys  # noqa: E402

import numpy as np  # noqa: E402

import numpy_tpgmm  # noqa: E402
from benchmarks.report import alternating, durations, without_options, write_report  # noqa: E402
from tpgmm_core import TPGMM  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from workloads import W1, W2, Workload, demonstrations, projected  # noqa: E402

REG_COVAR, TOL, MAX_ITER = 1e-5, 1e-5, 1000
#: Least ratio to numpy, by number of threads
LEAST = {1: 3.5, 2: 6.0}
#: Multiplications and additions of one exponential
EXPONENTIAL = 20


def operations(work: Workload) -> float:
    """Floating-point operations of one iteration: differences, whitening, exponentials, and the sums of moments."""
    D = work.D
    of_each_frame = 2 * D * (D + 1) + 6 * D + 3
    return work.n_demonstrations * work.n_samples * work.K * (work.n_frames * of_each_frame + EXPONENTIAL + 5)


def peak() -> float:
    """Floating-point operations per second of one core, in a product of two matrices."""
    n = 768
    A = np.random.default_rng(0).normal(size=(n, n))
    out = np.empty_like(A)
    return 2 * n**3 / float(durations(lambda: np.matmul(A, A, out=out), 5).min())


def measure(work: Workload) -> list[Row]:
    """A row for each number of threads; medians of runs in turns."""
    demos = demonstrations(work)
    X = projected(demos)
    times = np.concatenate([demo.times for demo in demos])

    def plain() -> numpy_tpgmm.NumpyTPGMM:
        return numpy_tpgmm.fit(list(X.values()), times, work.K, REG_COVAR, TOL, MAX_ITER)

    def ours(n_threads: int) -> TPGMM:
        model = TPGMM(work.K, reg_covar=REG_COVAR, tol=TOL, max_iter=MAX_ITER, n_threads=n_threads)
        return model.fit_projected(X)

    likelihood, first = plain().log_likelihoods[-1], ours(1)
    rows: list[Row] = []
    for n_threads, least in LEAST.items():
        plain_s, ours_s = alternating(plain, partial(ours, n_threads), rounds=2)
        model = ours(n_threads)
        ratio = float(np.median(plain_s) / np.median(ours_s))
        difference = abs(likelihood - model.log_likelihood_)
        is_equal = all(np.array_equal(model.covariances_[name], S) for name, S in first.covariances_.items())
        speed = operations(work) * model.n_iter_ / float(np.median(ours_s))
        rows.append(
            {
                "work": work.name,
                "threads": n_threads,
                "iterations": model.n_iter_,
                "numpy_ms": 1e3 * float(np.median(plain_s)),
                "tpgmm_ms": 1e3 * float(np.median(ours_s)),
                "ratio": ratio,
                "gflops": 1e-9 * speed,
                "share_of_peak": speed / (n_threads * peak()),
                "log_likelihood_difference": difference,
                "passed": bool(ratio >= least and difference < 1e-9 and is_equal),
            }
        )
    return rows


if __name__ == "__main__":
    without_options(__doc__)
    sys.exit(write_report("em", [*measure(W1), *measure(W2)]))
