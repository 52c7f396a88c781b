# SPDX-License-Identifier: Apache-2.0
"""Covariance structure and number of components for a real task, chosen by leave-one-out over demonstrations.

Six demonstrations of a Baxter that opens a valve (poses over time, two frames). For every candidate: the
log-likelihood of each demonstration under a model of the other five, and how well that model reproduces it, as
`train --leave-one-out`.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from tqdm import tqdm  # noqa: E402

from tpgmm_core import TPGMM, Demonstration, LearnedMixture  # noqa: E402
from tpgmm_core.common.report import format_table  # noqa: E402
from tpgmm_core.learning.covariance.structure import STRUCTURES  # noqa: E402
from tpgmm_core.learning.dirichlet import DirichletTPGMM  # noqa: E402
from tpgmm_core.learning.held_out import SelectableEstimator, unfitted  # noqa: E402
from tpgmm_core.learning.selection import Candidate, select_model  # noqa: E402
from tpgmm_core.retrieval.recipe import PRIOR_STRENGTH  # noqa: E402
from tpgmm_ros.models.validation import cross_validate, mean_errors  # noqa: E402
from tpgmm_ros.programs.reporting import write_report  # noqa: E402
from tpgmm_ros.recordings.bags import Recording, align, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.state_space import MANIFOLD  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

STRUCTURES_ON_POSES = [name for name in STRUCTURES if name != "deep_mfa"]  # divides components further


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = _parser().parse_args(arguments)
    if not options.data.is_dir():
        print(f"valve_selection: skipped, {options.data} is no directory; the data set is no part of this repository")
        return 0
    task = Task.load(options.task)
    recordings, bad = read_recordings(find_bags([options.data]), task, options.every)
    if bad:
        print(f"valve_selection: {bad[0]}", file=sys.stderr)
        return 1
    demonstrations, _ = align(recordings)
    candidates = _candidates(task, options)
    unfitted(next(iter(candidates.values()))).fit(demonstrations)  # so that no time is that of reading kernels
    with tqdm(desc="fits", disable=None, file=sys.stderr) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        table = select_model(candidates, demonstrations, progress=progress)
    rows = []
    for row in tqdm(table.rows, desc="reproductions", disable=None, file=sys.stderr):
        rows.append({**row.to_dict(), **_reproduction(row, candidates[row.name], recordings)})
    _print(table.rows, rows, table.best)
    by_bic = min((row for row in table.rows if row.error is None), key=lambda row: row.bic)
    print(f"\nheld out, the best is {table.best.name}; BIC would take {by_bic.name}")
    passed = is_borne_out(rows, table.best.name, by_bic.name)
    report = {"passed": passed, "best": table.best.name, "best_bic": by_bic.name}
    print(f"report: {write_report(options.output, {**report, 'demonstrations': len(recordings), 'candidates': rows})}")
    table.plot(options.output / "selection.png")
    return 0 if passed else 1


def is_borne_out(rows: Sequence[Mapping[str, Any]], best: str, best_bic: str) -> bool:
    """Whether all candidates could be fitted, and the one that is best held out reproduces no worse than BIC's."""
    if any(row["error"] is not None for row in rows):
        return False
    errors = {row["name"]: row["position_rmse_m"] for row in rows}
    return bool(errors[best] <= errors[best_bic])


def _candidates(task: Task, options: argparse.Namespace) -> dict[str, SelectableEstimator]:
    """Every structure with every K, other settings as `train` takes them; and a Dirichlet process with its own K."""
    settings = {"prior_strength": options.prior, **task.model, "manifold": MANIFOLD, "n_factors": options.factors}
    candidates: dict[str, SelectableEstimator] = {}
    for structure in options.structures:
        for K in options.components:
            candidates[f"{structure}, K = {K}"] = TPGMM(**{**settings, "n_components": K, "covariance": structure})
    if options.dirichlet:
        candidates["Dirichlet process"] = DirichletTPGMM(
            max(options.components), init="bins", reg_covar=settings["reg_covar"], manifold=MANIFOLD
        )
    return candidates


def _reproduction(row: Candidate, estimator: SelectableEstimator, recordings: list[Recording]) -> dict[str, Any]:
    """Mean errors of reproducing each recording by a model of the others."""
    if row.error is not None:
        return {"position_rmse_m": None, "orientation_mean_deg": None}

    def learn(demonstrations: list[Demonstration]) -> LearnedMixture:
        model = unfitted(estimator)
        assert isinstance(model, LearnedMixture)
        model.fit(demonstrations)
        model.metadata_["duration_s"] = float(np.mean([shown.times[-1] - shown.times[0] for shown in demonstrations]))
        return model

    folds = cross_validate(recordings, learn, next(iter(recordings[0].frames)))
    errors = mean_errors([fold.model for fold in folds])
    return {"position_rmse_m": errors.position_rmse_m, "orientation_mean_deg": errors.orientation_mean_deg}


def _print(rows: Sequence[Candidate], values: Sequence[dict[str, Any]], best: Candidate) -> None:
    header = (
        "",
        "structure",
        "K",
        "parameters",
        "held out",
        "+-",
        "median",
        "fitted",
        "BIC",
        "RMSE m",
        "deg",
        "fit ms",
    )
    lines: list[tuple[Any, ...]] = []
    for row, value in zip(rows, values, strict=True):
        if row.error is not None:
            lines.append(("", row.structure, row.n_components, *"-" * 8, row.error))
            continue
        assert row.by_demonstration is not None
        lines.append(
            (
                "*" if row is best else "",
                row.structure,
                row.n_components,
                row.n_parameters,
                f"{row.held_out:.2f}",
                f"{row.held_out_error:.2f}",
                f"{np.median(row.by_demonstration):.2f}",
                f"{row.log_likelihood:.2f}",
                f"{row.bic:.0f}",
                f"{value['position_rmse_m']:.3f}",
                f"{value['orientation_mean_deg']:.1f}",
                f"{1e3 * row.fit_time_s:.0f}",
            )
        )
    print(
        "log-likelihood per sample: held out (with its standard error, and the median, over demonstrations), and fitted"
    )
    print(format_table(header, lines))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="valve_selection", description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data/baxter_valve"), help="directory of the bags")
    parser.add_argument("--task", type=Path, default=Path("config/baxter_valve.yaml"), help="task file")
    parser.add_argument("--components", type=int, nargs="+", metavar="K", default=[3, 5, 7, 10, 15])
    parser.add_argument("--structures", nargs="+", choices=STRUCTURES, default=STRUCTURES_ON_POSES)
    parser.add_argument("--factors", type=int, metavar="D", default=3, help="of mfa, mppca and deep_mfa (default: 3)")
    parser.add_argument(
        "--prior",
        type=float,
        default=PRIOR_STRENGTH,
        help="of the covariances, in demonstrations (default: %(default)s)",
    )
    parser.add_argument("--no-dirichlet", dest="dirichlet", action="store_false", help="without the Dirichlet process")
    parser.add_argument("--every", type=int, metavar="N", default=1, help="use every N-th sample (default: all)")
    parser.add_argument(
        "--output", type=Path, default=Path("out/valve_selection"), help="of report.json, selection.png"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
