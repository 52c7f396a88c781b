# SPDX-License-Identifier: Apache-2.0
"""Factor analyzers against full covariances where dimensions are many: 50 joints, position and velocity.

Movements of 50 joints (D = 100) come from a few synergies, in which four frames differ from demonstration to
demonstration; each joint has noise of its own. Models learn from 20 demonstrations of 500 samples and are judged by
the log-likelihood of others, in situations of their own. Both kinds start from the same bins and stop by the same
rule; log-likelihoods are in nats per sample, of all frames together. The verdict is on the number of factors that is
best on the others.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from benchmarks.report import write_report  # noqa: E402
from tpgmm_core import TPGMM, Demonstration, Frame  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402

DT = 0.01
"""Time step of the samples, s."""


@dataclass(frozen=True)
class Body:
    """What all demonstrations have in common.

    Parameters
    ----------
    synergies
        shape (J, S), orthonormal columns, rad
    paths
        per frame the course of the synergies, positions and velocities (P, T, 2, S)
    shares
        shape (P, T), how much each frame counts when
    noise
        shape (2 J,), standard deviations, rad and rad/s
    """

    synergies: Array
    paths: Array
    shares: Array
    noise: Array

    @classmethod
    def random(cls, rng: np.random.Generator, n_joints: int, n_synergies: int, n_frames: int, T: int) -> Body:
        """Smooth paths in each frame, and frames that count one after the other."""
        t = DT * np.arange(T)
        phase = t / t[-1]
        bumps = np.exp(-0.5 * ((phase[:, None] - np.linspace(0.0, 1.0, 8)) / 0.12) ** 2)
        positions = np.einsum("tb,pbs->pts", bumps, rng.normal(size=(n_frames, 8, n_synergies)))
        paths = np.stack([positions, np.gradient(positions, DT, axis=1)], axis=2)
        centres = np.linspace(0.0, 1.0, n_frames)[:, None]
        shares = np.exp(-0.5 * ((phase - centres) / (0.5 / n_frames)) ** 2)
        synergies = np.linalg.qr(rng.normal(size=(n_joints, n_synergies)))[0]
        noise = rng.uniform(0.02, 0.1, size=2 * n_joints) * np.repeat([1.0, 3.0], n_joints)
        return cls(synergies, paths, shares / shares.sum(axis=0), noise)

    def demonstration(self, rng: np.random.Generator) -> Demonstration:
        """A movement in a new situation: each frame turns and shifts the synergies at random."""
        J, S = self.synergies.shape
        W = np.kron(np.eye(2), self.synergies)
        frames = {}
        course = np.zeros((self.paths.shape[1], 2 * S))
        for j, (path, share) in enumerate(zip(self.paths, self.shares, strict=True)):
            Q = np.linalg.qr(np.eye(S) + 0.3 * rng.normal(size=(S, S)))[0]
            shift = np.concatenate([rng.normal(size=S), np.zeros(S)])
            turn = np.kron(np.eye(2), Q)
            frames[f"frame_{j}"] = Frame(np.eye(2 * J) + W @ (turn - np.eye(2 * S)) @ W.T, W @ shift)
            course += share[:, None] * (path.reshape(len(path), -1) @ turn.T + shift)
        course += 0.15 * np.sin(DT * np.arange(len(course)) + rng.uniform(0.0, 6.0))[:, None] * rng.normal(size=2 * S)
        data = course @ W.T + self.noise * rng.normal(size=(len(course), 2 * J))
        return Demonstration(DT * np.arange(len(data), dtype=float), np.asarray(data, dtype=np.float64), frames)


def fit_time(model: TPGMM, demonstrations: Sequence[Demonstration]) -> float:
    """Fit, and say how long it took, s."""
    begin = time.perf_counter()
    model.fit(demonstrations)
    return time.perf_counter() - begin


def described(name: str, model: TPGMM, others: Sequence[Demonstration], fit_s: float) -> dict[str, Any]:
    """One row of the table."""
    return {
        "structure": name,
        "n_parameters": model.n_parameters_,
        "log_likelihood": model.log_likelihood_,
        "held_out": model.score(others),
        "fit_s": fit_s,
        "iterations": model.n_iter_,
        "per_iteration_s": fit_s / model.n_iter_,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/high_dimension"), help="of report.json and picture")
    parser.add_argument("--joints", type=int, default=50, help="half of the dimensions (default: %(default)s)")
    parser.add_argument("--components", type=int, default=8, help="K (default: %(default)s)")
    parser.add_argument("--synergies", type=int, default=5, help="that move the joints (default: %(default)s)")
    parser.add_argument("--factors", type=int, nargs="+", default=[5, 10, 15], help="(default: %(default)s)")
    parser.add_argument("--iterations", type=int, default=100, help="at most (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="fits of each, median time (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the movements (default: %(default)s)")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    body = Body.random(rng, options.joints, options.synergies, n_frames=4, T=500)
    demonstrations = [body.demonstration(rng) for _ in range(20)]
    others = [body.demonstration(rng) for _ in range(5)]

    candidates = {"full": ("full", 1), "diag": ("diag", 1)}
    candidates |= {f"mfa, d = {d}": ("mfa", d) for d in options.factors}
    models = {
        name: TPGMM(
            options.components, init="bins", covariance=covariance, n_factors=n_factors, reg_covar=1e-5,
            tol=1e-3, max_iter=options.iterations,
        )
        for name, (covariance, n_factors) in candidates.items()
    }  # fmt: skip
    times: dict[str, list[float]] = {name: [] for name in models}
    for _ in range(options.rounds):  # in turns, so that what else the machine does meets all alike
        for name, model in models.items():
            times[name].append(fit_time(model, demonstrations))
            print(f"{name}: {times[name][-1]:.1f} s", file=sys.stderr)
    rows = [described(name, model, others, float(np.median(times[name]))) for name, model in models.items()]
    rows = [{**row, **_against(rows[0], row)} for row in rows]
    best = max((row for row in rows if "mfa" in str(row["structure"])), key=lambda row: row["held_out"])
    others_best = max(row["held_out"] for row in rows if "mfa" not in str(row["structure"]))
    wins = bool(best["held_out"] > others_best and best["speed_up"] > 1.0)
    rows = [{**row, "passed": wins if row is best else None} for row in rows]
    status = write_report("report", rows, options.output)
    _picture(rows, options.output / "high_dimension.png")
    print(f"picture: {options.output / 'high_dimension.png'}")
    return status


def _against(full: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, float]:
    return {"gain": row["held_out"] - full["held_out"], "speed_up": full["fit_s"] / row["fit_s"]}


def _picture(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    names = [str(row["structure"]) for row in rows]
    where = np.arange(len(rows))
    for shift, key in ((-0.2, "log_likelihood"), (0.2, "held_out")):
        left.bar(where + shift, [row[key] for row in rows], width=0.4, label=key.replace("_", " "))
    left.set_ylabel("nats per sample, four frames together")
    left.legend(frameon=False)
    right.bar(where, [row["fit_s"] for row in rows], width=0.6, color="grey")
    right.set_ylabel("time to fit / s")
    for axes in (left, right):
        axes.set_xticks(where, names, rotation=20)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    sys.exit(main())
