# SPDX-License-Identifier: Apache-2.0
"""What a figure must show, in numbers: each claim is a row of its report; exit status 1 where one does not hold."""

from __future__ import annotations

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from examples.report import write_report
from tpgmm_core.common.report import Row


def at_most(claim: str, measured: float, bound: float) -> Row:
    """A claim that holds where a number is small enough."""
    return {"claim": claim, "measured": float(measured), "bound": f"<= {bound:g}", "passed": bool(measured <= bound)}


def at_least(claim: str, measured: float, bound: float) -> Row:
    """A claim that holds where a number is large enough."""
    return {"claim": claim, "measured": float(measured), "bound": f">= {bound:g}", "passed": bool(measured >= bound)}


def options_of(description: str | None, name: str) -> ArgumentParser:
    """The options that every figure has: where its picture and its report go."""
    parser = ArgumentParser(description=description, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/figures"), help=f"of {name}.json and {name}.png")
    return parser


def canvas(width: float, height: float) -> Figure:
    """An empty figure of this size in inches, which needs no screen."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(name: str, figure: Figure, rows: Sequence[Row], directory: Path) -> int:
    """Write report and picture, and return the exit status: 0 if all claims hold."""
    write_report(name, rows, directory)
    figure.savefig(directory / f"{name}.png", dpi=80)
    print(f"picture: {directory / name}.png")
    return 0 if all(row["passed"] for row in rows) else 1
