# SPDX-License-Identifier: Apache-2.0
"""Choosing a model: a table of candidates, by leave-one-out over demonstrations, BIC or AIC.

BIC and AIC are cheaper than leaving demonstrations out, and prefer too many components (see
`tpgmm_core.learning.criteria`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from tpgmm_core.common.report import format_table
from tpgmm_core.learning import criteria
from tpgmm_core.learning.held_out import FoldProgress, SelectableEstimator, leave_one_out, unfitted
from tpgmm_core.model.demonstration import Demonstration

CRITERIA = ("leave-one-out", "bic", "aic")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One row of a table: a candidate and its scores.

    Parameters
    ----------
    name
        of the candidate
    structure
        of its covariances, with the kind of model where that is no mixture
    n_components
        K
    n_parameters
        free parameters
    log_likelihood
        per sample, of the data that it was fitted to
    held_out
        the same of data that it was not fitted to; None where that was not computed
    held_out_error
        standard error of `held_out` over the demonstrations
    by_demonstration
        `held_out` of each demonstration, since one unusual situation may outweigh the rest
    bic, aic
        see `tpgmm_core.learning.criteria`
    fit_time_s
        of the fit to all demonstrations, s
    error
        why it could not be fitted; all numbers are then NaN
    model
        the estimator, fitted to all demonstrations
    """

    name: str
    structure: str
    n_components: int
    n_parameters: int = 0
    log_likelihood: float = np.nan
    held_out: float | None = None
    held_out_error: float | None = None
    by_demonstration: tuple[float, ...] | None = None
    bic: float = np.nan
    aic: float = np.nan
    fit_time_s: float = np.nan
    error: str | None = None
    model: SelectableEstimator | None = field(default=None, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts, None for what is not known."""
        values = {name: getattr(self, name) for name in self.__slots__ if name != "model"}
        return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()}


@dataclass(frozen=True, slots=True, eq=False)
class SelectionTable:
    """Candidates in the order given, and the criterion that chooses among them."""

    rows: Sequence[Candidate]
    criterion: str

    @property
    def best(self) -> Candidate:
        """The row that the criterion prefers; of equals, that with fewer parameters.

        Raises
        ------
        ValueError
            when no candidate could be fitted
        """
        good = [row for row in self.rows if row.error is None]
        if not good:
            raise ValueError(f"no candidate could be fitted; the first says: {self.rows[0].error}")
        return min(good, key=lambda row: (self._cost(row), row.n_parameters))

    def _cost(self, row: Candidate) -> float:
        if self.criterion == "leave-one-out":
            assert row.held_out is not None
            return -row.held_out
        return row.bic if self.criterion == "bic" else row.aic

    def to_dict(self) -> dict[str, Any]:
        """For JSON: {"criterion", "best", "rows"}."""
        best = self.best.name if any(row.error is None for row in self.rows) else None
        return {"criterion": self.criterion, "best": best, "rows": [row.to_dict() for row in self.rows]}

    def save(self, path: str | PathLike[str]) -> None:
        """Write `to_dict` as JSON."""
        with open(path, "w", encoding="utf-8") as stream:
            json.dump(self.to_dict(), stream, indent=2, allow_nan=False)
            stream.write("\n")

    def __str__(self) -> str:
        """A table; * marks the best row."""
        best = self.best if any(row.error is None for row in self.rows) else None
        head = ["", "structure", "K", "parameters", "log-likelihood", "held out", "+-", "BIC", "AIC", "fit s", ""]
        lines = []
        for row in self.rows:
            numbers = (row.log_likelihood, row.held_out, row.held_out_error)
            cells = ["-" if v is None or not np.isfinite(v) else f"{v:.3f}" for v in numbers]
            cells += ["-" if not np.isfinite(v) else f"{v:.0f}" for v in (row.bic, row.aic)]
            cells += ["-" if not np.isfinite(row.fit_time_s) else f"{row.fit_time_s:.3f}"]
            mark = "*" if row is best else ""
            lines.append([mark, row.structure, row.n_components, row.n_parameters, *cells, row.error or ""])
        return format_table(head, lines)

    def plot(self, path: str | PathLike[str]) -> None:
        """Draw the criterion over K, a line for each structure (needs matplotlib).

        For leave-one-out: the held-out log-likelihood, with standard errors over the demonstrations, beside BIC, which
        shows how optimistic BIC is.

        Parameters
        ----------
        path
            of the picture
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        panels: list[tuple[str, Callable[[Candidate], float]]] = [("BIC: the smaller, the better", lambda row: row.bic)]
        if self.criterion == "leave-one-out":
            panels.insert(0, ("held-out log-likelihood per sample", lambda row: _or_nan(row.held_out)))
        elif self.criterion == "aic":
            panels.insert(0, ("AIC: the smaller, the better", lambda row: row.aic))
        good = [row for row in self.rows if row.error is None]
        figure = Figure(figsize=(6.0 * len(panels), 4.5), layout="constrained")
        FigureCanvasAgg(figure)
        for i, (label, value) in enumerate(panels):
            axes = figure.add_subplot(1, len(panels), i + 1)
            for number, structure in enumerate(dict.fromkeys(row.structure for row in good)):
                rows = sorted((row for row in good if row.structure == structure), key=lambda row: row.n_components)
                held_out = self.criterion == "leave-one-out" and i == 0
                axes.errorbar(
                    [row.n_components + 0.05 * number for row in rows],  # so that error bars lie side by side
                    [value(row) for row in rows],
                    yerr=[row.held_out_error or 0.0 for row in rows] if held_out else None,
                    marker="o", markersize=4, linewidth=1.2, capsize=2, elinewidth=0.6, label=structure,
                )  # fmt: skip
            axes.set_xlabel("components K")
            axes.set_ylabel(label)
            axes.grid(alpha=0.3)
        figure.axes[0].legend(frameon=False)
        figure.savefig(path, dpi=120)


def select_model(
    candidates: Sequence[SelectableEstimator] | Mapping[str, SelectableEstimator],
    demonstrations: Sequence[Demonstration],
    criterion: str = "leave-one-out",
    progress: FoldProgress | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> SelectionTable:
    """Fit all candidates and compare them.

    A candidate that cannot be fitted gets a row with the reason.

    Parameters
    ----------
    candidates
        estimators, which are not changed; or name → estimator
    demonstrations
        at least two for leave-one-out
    criterion
        "leave-one-out": the held-out log-likelihood, for which each candidate is fitted once more for each
        demonstration; "bic" or "aic"
    progress
        called with (fits done, fits)
    clock
        returns a time in s, to measure fit_time_s

    Returns
    -------
    SelectionTable
        a row for each candidate

    Raises
    ------
    ValueError
        for an unknown criterion, for no candidates, and for too few demonstrations
    """
    if criterion not in CRITERIA:
        raise ValueError(f"the criterion is one of {', '.join(CRITERIA)}, got {criterion!r}")
    demonstrations = list(demonstrations)
    n_folds = len(demonstrations) if criterion == "leave-one-out" else 0
    if n_folds == 1 or not demonstrations:
        raise ValueError(f"{criterion} needs more demonstrations than {len(demonstrations)}: record more")
    named = _named(candidates)
    total = len(named) * (1 + n_folds)
    rows = []
    for c, (name, estimator) in enumerate(named.items()):
        done = c * (1 + n_folds)

        def folds_done(folds: int, _: int, done: int = done) -> None:
            if progress is not None:
                progress(done + 1 + folds, total)

        rows.append(_row(name, estimator, demonstrations, n_folds > 0, folds_done, clock))
        folds_done(n_folds, n_folds)
    return SelectionTable(rows, criterion)


def _row(
    name: str,
    estimator: SelectableEstimator,
    demonstrations: Sequence[Demonstration],
    hold_out: bool,
    folds_done: FoldProgress,
    clock: Callable[[], float],
) -> Candidate:
    structure, K = _structure(estimator), int(estimator.get_params().get("n_components", 0))
    model = unfitted(estimator)
    try:
        start = clock()
        model.fit(demonstrations)
        fit_time = clock() - start
        folds_done(0, 0)
        held_out = leave_one_out(estimator, demonstrations, folds_done) if hold_out else None
    except ValueError as error:
        return Candidate(name, structure, K, error=str(error))
    N = sum(len(demonstration.times) for demonstration in demonstrations)
    per_sample = model.score(demonstrations)
    return Candidate(
        name=name,
        structure=structure,
        n_components=len(model.priors_),
        n_parameters=model.n_parameters_,
        log_likelihood=per_sample,
        held_out=None if held_out is None else held_out.per_sample,
        held_out_error=None if held_out is None else held_out.standard_error,
        by_demonstration=None if held_out is None else tuple(held_out.per_demonstration.tolist()),
        bic=criteria.bic(N * per_sample, model.n_parameters_, N),
        aic=criteria.aic(N * per_sample, model.n_parameters_),
        fit_time_s=fit_time,
        model=model,
    )


def _structure(estimator: SelectableEstimator) -> str:
    """A name such as "full", "mfa 2", "TPHMM full"."""
    params = estimator.get_params()
    structure = str(params.get("covariance", "full"))
    if structure in ("mfa", "mppca", "deep_mfa"):
        structure += f" {params.get('n_factors')}"
    kind = type(estimator).__name__
    return structure if kind == "TPGMM" else f"{kind} {structure}"


def _named(
    candidates: Sequence[SelectableEstimator] | Mapping[str, SelectableEstimator],
) -> dict[str, SelectableEstimator]:
    if isinstance(candidates, Mapping):
        named = dict(candidates)
    else:
        names = [f"{_structure(c)}, K = {c.get_params().get('n_components')}" for c in candidates]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ValueError(
                f"several candidates would have the name {sorted(twice)}: give a mapping from distinct names to "
                "candidates"
            )
        named = dict(zip(names, candidates, strict=True))
    if not named:
        raise ValueError("select_model needs at least one candidate")
    return named


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
