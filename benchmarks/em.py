# SPDX-License-Identifier: Apache-2.0
"""EM to convergence: TPGMM against careful vectorised numpy, one thread each."""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import sys  # noqa: E402

import numpy as np  # noqa: E402

import numpy_tpgmm  # noqa: E402
from benchmarks.report import alternating, write_report  # noqa: E402
from tpgmm_core import TPGMM  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from workloads import W1, W2, Workload, demonstrations, projected  # noqa: E402

REG_COVAR, TOL, MAX_ITER = 1e-5, 1e-5, 1000


def measure(work: Workload) -> Row:
    """One row of the table; medians of runs in turns."""
    demos = demonstrations(work)
    X = projected(demos)
    times = np.concatenate([demo.times for demo in demos])
    model = TPGMM(work.K, reg_covar=REG_COVAR, tol=TOL, max_iter=MAX_ITER)

    def plain() -> numpy_tpgmm.NumpyTPGMM:
        return numpy_tpgmm.fit(list(X.values()), times, work.K, REG_COVAR, TOL, MAX_ITER)

    plain_s, ours_s = alternating(plain, lambda: model.fit_projected(X), rounds=3, repetitions=2)
    ratio = float(np.median(plain_s) / np.median(ours_s))
    difference = abs(plain().log_likelihoods[-1] - model.log_likelihood_)
    return {
        "work": work.name,
        "iterations": model.n_iter_,
        "numpy_ms": 1e3 * float(np.median(plain_s)),
        "tpgmm_ms": 1e3 * float(np.median(ours_s)),
        "ratio": ratio,
        "log_likelihood_difference": difference,
        "passed": bool(ratio >= 3.5 and difference < 1e-9),
    }


if __name__ == "__main__":
    sys.exit(write_report("em", [measure(W1), measure(W2)]))
