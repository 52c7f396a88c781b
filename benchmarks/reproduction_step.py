# SPDX-License-Identifier: Apache-2.0
"""One reproduction step: new frames in, adapt all components (Eqs. 5, 6), regression at one time, Gaussian out."""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import gc  # noqa: E402
import sys  # noqa: E402

import numpy as np  # noqa: E402

import numpy_tpgmm  # noqa: E402
from benchmarks.report import alternating, durations, without_options, write_report  # noqa: E402
from tpgmm_core import TPGMM, Adapter, Gaussian  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from workloads import W1, W2, Workload, demonstrations, pose_demonstrations  # noqa: E402

TIMES = np.array([0.7])


SEVERAL = np.linspace(0.0, 2.0, 200)[:, None]


def measure(work: Workload) -> list[Row]:
    """Rows of the table: percentiles over steps, by an `Adapter` that a loop holds on to and by the plain calls."""
    model = TPGMM(work.K, reg_covar=1e-5).fit(demonstrations(work))
    adapter = Adapter(model)
    frames = demonstrations(work, seed=1)[0].frames
    plain_model = numpy_tpgmm.NumpyTPGMM(model.priors_, list(model.means_.values()), list(model.covariances_.values()))
    plain_frames = [(frame.A, frame.b) for frame in frames.values()]

    def plain() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        means, covariances = numpy_tpgmm.adapt(plain_model, plain_frames)
        return numpy_tpgmm.condition_on_first(plain_model.priors, means, covariances, TIMES[0])

    def calls() -> Gaussian:
        return model.adapt(frames).condition([0], [0.7])

    mean, covariance, _ = plain()
    error = max(np.abs(calls().mean - mean).max(), np.abs(calls().covariance - covariance).max())
    rows: list[Row] = []
    for name, ours in (("adapter", lambda: adapter.adapt_and_condition(frames, TIMES)), ("plain calls", calls)):
        plain_s, ours_s = alternating(plain, ours, 20, repetitions=500)
        row = percentiles(ours_s)
        ratio = float(np.median(plain_s) / np.median(ours_s))
        passed = ratio >= 5.0 and row["p99_us"] <= 3.0 * row["p50_us"] and error <= 1e-12
        plain_row = {f"numpy_{key}": value for key, value in percentiles(plain_s).items()}
        rows.append({"work": f"{work.name}, {name}", **plain_row, **row, "ratio": ratio, "passed": bool(passed)})
    return rows


def measure_several(work: Workload) -> Row:
    """Regression at one time and at 200 in one call, in the same situation; the ratio is that of their times."""
    model = TPGMM(work.K, reg_covar=1e-5).fit(demonstrations(work))
    mixture = model.adapt(demonstrations(work, seed=1)[0].frames)
    one_s, several_s = alternating(
        lambda: mixture.condition([0], [0.7]), lambda: mixture.condition([0], SEVERAL), 20, repetitions=500
    )
    row = percentiles(several_s)
    ratio = float(np.median(several_s) / np.median(one_s))
    one = percentiles(one_s)
    return {
        "work": work.name, "one_p50_us": one["p50_us"], "one_p99_us": one["p99_us"],
        "200_p50_us": row["p50_us"], "200_p99_us": row["p99_us"], "times_one": ratio, "passed": ratio <= 3.0,
    }  # fmt: skip


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
    without_options(__doc__)
    gc.freeze()
    status = write_report("reproduction_step", [*measure(W1), *measure(W2), measure_poses()])
    sys.exit(status | write_report("regression_at_several_times", [measure_several(W1), measure_several(W2)]))
