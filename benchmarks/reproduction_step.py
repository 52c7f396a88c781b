# SPDX-License-Identifier: Apache-2.0
"""One reproduction step: new frames in, adapt all components (Eqs. 5, 6), regression at one time, Gaussian out."""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import gc  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks import numpy_tpgmm  # noqa: E402
from benchmarks.report import Row, alternating, durations, write_report  # noqa: E402
from benchmarks.workloads import W1, W2, Workload, demonstrations, pose_demonstrations  # noqa: E402
from tpgmm_core import TPGMM, Adapter  # noqa: E402

TIMES = np.array([0.7])


def measure(work: Workload) -> Row:
    """One row of the table: percentiles over steps."""
    model = TPGMM(work.K, reg_covar=1e-5).fit(demonstrations(work))
    adapter = Adapter(model)
    frames = demonstrations(work, seed=1)[0].frames
    plain_model = numpy_tpgmm.NumpyTPGMM(model.priors_, list(model.means_.values()), list(model.covariances_.values()))
    plain_frames = [(frame.A, frame.b) for frame in frames.values()]

    def plain() -> None:
        means, covariances = numpy_tpgmm.adapt(plain_model, plain_frames)
        numpy_tpgmm.condition_on_first(plain_model.priors, means, covariances, TIMES[0])

    plain_s, ours_s = alternating(plain, lambda: adapter.adapt_and_condition(frames, TIMES), 20, repetitions=500)
    row = percentiles(ours_s)
    ratio = float(np.median(plain_s) / np.median(ours_s))
    passed = ratio >= 5.0 and row["p99_us"] <= 3.0 * row["p50_us"]
    plain_row = {f"numpy_{key}": value for key, value in percentiles(plain_s).items()}
    return {"work": work.name, **plain_row, **row, "ratio": ratio, "passed": passed}


def measure_poses() -> Row:
    """Poses over time, R1 x R3 x S3, 3 frames, 10 components; there is no plain version of it."""
    model = TPGMM(10, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(pose_demonstrations(n_demonstrations=10))
    adapter = Adapter(model)
    frames = pose_demonstrations(n_demonstrations=1, seed=1)[0].frames
    row = percentiles(durations(lambda: adapter.adapt_and_condition(frames, TIMES), 10000))
    passed = row["p99_us"] <= 3.0 * row["p50_us"]
    return {"work": "poses", "numpy_p50_us": None, "numpy_p99_us": None, **row, "ratio": None, "passed": passed}


def percentiles(seconds: np.ndarray) -> dict[str, float]:
    """The middle and the slow end, in us."""
    return {"p50_us": 1e6 * float(np.median(seconds)), "p99_us": 1e6 * float(np.percentile(seconds, 99))}


if __name__ == "__main__":
    gc.freeze()
    write_report("reproduction_step", [measure(W1), measure(W2), measure_poses()])
