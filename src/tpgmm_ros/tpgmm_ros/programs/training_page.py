# SPDX-License-Identifier: Apache-2.0
"""A training as one HTML page with its pictures in it: what was learned, how exact it is, and what is doubtful."""

from __future__ import annotations

import html
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.relevance import position_dimensions, relevance
from tpgmm_ros.models.validation import Fold
from tpgmm_ros.programs.svg import COLOURS, Plane, legend, shares_over_time
from tpgmm_ros.recordings.bags import Recording, align

POINTS = 120
"""Of each path in a picture, at most."""
PLANES = (("x", "y", 0, 1), ("x", "z", 0, 2))
FACTS = (
    "retrieval", "frames", "demonstrations", "samples", "duration_s", "components", "iterations", "log_likelihood",
)  # fmt: skip
STYLE = """\
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse } td, th { padding: .15em .7em; border-bottom: 1px solid #ddd; text-align: left }
svg { margin: 4px; font: 11px sans-serif } code, pre { background: #f4f4f4; padding: .2em .4em; white-space: pre-wrap }
.doubt { background: #fff3cd; padding: .3em .6em; margin: .3em 0 } .refused { background: #f8d7da }"""


def write_page(
    path: Path,
    command: Sequence[str],
    report: Mapping[str, Any],
    model: LearnedMixture | None,
    recordings: Sequence[Recording],
    folds: Sequence[Fold],
) -> None:
    """Write the page; an older one is replaced only when the new one is complete.

    Parameters
    ----------
    path
        of the page
    command
        arguments of `train`
    report
        what report.json holds
    model
        what was learned; None where nothing was
    recordings
        what it was learned from
    folds
        of leave-one-out; none where it was not asked for

    Raises
    ------
    OSError
        it cannot be written.
    """
    parts = [_head(command, report), _doubts(report)]
    if model is not None:
        parts += [_facts(report), _relevance(model)]
        if recordings and recordings[0].configurations is None:
            parts.append(_demonstrations(model, recordings))
    parts.append(_left_out(folds, report.get("leave_one_out")))
    title = html.escape(f"training of {report.get('task', 'a model')}")
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"</head><body><h1>{title}</h1>\n{''.join(parts)}</body></html>\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda draft: draft.write_text(page, encoding="utf-8"))


def _head(command: Sequence[str], report: Mapping[str, Any]) -> str:
    text = f"<p>This repeats it:</p><pre>train {html.escape(shlex.join(command))}</pre>"
    if error := report.get("error"):
        text += f'<p class="doubt refused">Nothing was learned: {html.escape(error)}</p>'
    return text


def _doubts(report: Mapping[str, Any]) -> str:
    """What makes no sense, what was put right, and what little was shown."""
    lines = [
        f'<p class="doubt{" refused" if item["refuses"] else ""}">{html.escape(str(Doubt(**item)))}</p>'
        for item in report.get("doubts", ())
    ]
    lines += [f'<p class="doubt refused">{html.escape(item["error"])}</p>' for item in report.get("bad_bags", ())]
    notes = [f"{Path(bag['bag']).name}: {note}" for bag in report.get("bags", ()) for note in bag["notes"]]
    if report.get("converged") is False:
        lines.append('<p class="doubt">EM did not converge: raise max_iter</p>')
    if not lines and "error" not in report:
        lines.append("<p>None: all recordings make sense.</p>")
    if situations := report.get("situations_text"):
        lines.append(f"<p>{html.escape(situations)}</p>")
    if notes:
        lines.append(f"<details><summary>{len(notes)} notes</summary>{_list(notes)}</details>")
    return f"<h2>Doubts</h2>{''.join(lines)}"


def _facts(report: Mapping[str, Any]) -> str:
    keys = (
        "retrieval",
        "frames",
        "demonstrations",
        "samples",
        "duration_s",
        "components",
        "iterations",
        "log_likelihood",
    )
    rows = [(key.replace("_", " "), _value(report[key])) for key in keys if key in report]
    bags = [(Path(bag["bag"]).name, bag["samples"], f"{bag['duration_s']:.2f} s") for bag in report.get("bags", ())]
    table = _table(("recording", "samples", "duration"), bags)
    return f"<h2>What was learned</h2>{_table(('', ''), rows)}<details><summary>recordings</summary>{table}</details>"


def _relevance(model: LearnedMixture) -> str:
    try:
        found = relevance(model, 50)
    except ValueError as error:
        return f"<h2>When each frame counts</h2><p>{html.escape(str(error))}</p>"
    if found.along == "movement":
        return f"<h2>When each frame counts</h2>{shares_over_time(found.shares, 'shares of the frames')}"
    header = ("frame", *(str(k) for k in range(len(next(iter(found.shares.values()))))))
    rows = [(name, *(f"{share:.2f}" for share in shares)) for name, shares in found.shares.items()]
    return f"<h2>How much each frame counts in each component</h2>{_table(header, rows)}"


def _demonstrations(model: LearnedMixture, recordings: Sequence[Recording]) -> str:
    """As each frame sees them, with the components at two standard deviations."""
    shown, derived = align(recordings)[0], DerivedFrames.of_metadata(model.metadata_)
    missing = [name for name in derived.sources if name not in shown[0].frames]
    shown = [derived.only(missing).extended(item) for item in shown]
    places, tangent = position_dimensions(model)
    parts = []
    for name in model.frame_names_:
        views = [_thinned(_seen_from(item, name)) for item in shown]
        for across, up, i, j in PLANES:
            plane = Plane(f"seen from {name}", across, up)
            plane.paths = [(view[:, [i, j]], COLOURS[k % len(COLOURS)], 0.7) for k, view in enumerate(views)]
            if len(places) == 3:
                centres = model.means_[name][:, [places[i], places[j]]]
                axes = tangent[[i, j]]
                covariances = model.covariances_[name][:, axes[:, None], axes]
                plane.ellipses = list(zip(centres, covariances, strict=True))
            parts.append(plane.draw())
    what = "Paths of the hand; ellipses are the components of the model, at two standard deviations."
    return f"<h2>Demonstrations in each frame</h2><p>{what}</p>{''.join(parts)}"


def _seen_from(shown: Demonstration, name: str) -> Array:
    """Positions (T, 3) of a demonstration in a frame, where the frame was seen."""
    frame, places = shown.frames[name], shown.data[:, 1:4]
    A, b = frame.A[..., 1:4, 1:4], frame.b[..., 1:4]
    seen = np.linalg.solve(np.broadcast_to(A, (len(places), 3, 3)), (places - b)[:, :, None])[:, :, 0]
    seen = seen[shown.is_visible(name)]
    return seen if len(seen) else np.zeros((1, 3))


def _thinned(path: Array) -> Array:
    return path[np.unique(np.linspace(0, len(path) - 1, min(len(path), POINTS)).round().astype(int))]


def _left_out(folds: Sequence[Fold], found: Mapping[str, Any] | None) -> str:
    if not folds or found is None:
        return (
            "<h2>Demonstrations left out</h2><p>How exact the model is was not tried: <code>--leave-one-out</code> "
            "reproduces each demonstration by a model of the others.</p>"
        )
    rows, pictures = [], []
    for fold in folds:
        errors, name = fold.model, fold.recording.name
        rows.append(_errors(name, errors.position_rmse_m, errors.position_end_m, errors.orientation_mean_deg))
        for across, up, i, j in PLANES:
            plane = Plane(name, across, up)
            plane.paths = [
                (fold.recording.movement[:, [i, j]], COLOURS[0], 1.0),
                (fold.path[:, [i, j]], COLOURS[1], 1.0),
            ]
            pictures.append(plane.draw())
    mean, nearest = found["mean"], found["mean_nearest"]
    for name, item in (("mean", mean), ("nearest demonstration, moved", nearest)):
        rows.append(_errors(name, item["position_rmse_m"], item["position_end_m"], item["orientation_mean_deg"]))
    calibration = found["calibration"]
    coverage = [
        (f"{float(level):.0%}", f"{share:.2f}", f"{calibration['scaled_coverage'][level]:.2f}")
        for level, share in calibration["coverage"].items()
    ]
    return (
        "<h2>Demonstrations left out</h2><p>Each was reproduced by a model of the others, in its situation.</p>"
        f"{_table(('left out', 'RMSE m', 'end m', 'mean deg'), rows)}"
        "<h3>Coverage</h3><p>Share of the poses left out that lie in the region of so many per cent; covariances are "
        f"scaled by {calibration['scale']:.2f}.</p>{_table(('region', 'as learned', 'scaled'), coverage)}"
        f"<h3>Paths</h3><p>{legend(('shown', 'reproduced'))}</p>{''.join(pictures)}"
    )


def _errors(name: str, path: float, end: float, turn: float) -> tuple[str, ...]:
    return name, f"{path:.3f}", f"{end:.3f}", f"{turn:.1f}"


def _value(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    cells = [f"<tr>{''.join(f'<td>{html.escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows]
    head = f"<tr>{''.join(f'<th>{html.escape(cell)}</th>' for cell in header)}</tr>" if any(header) else ""
    return f"<table>{head}{''.join(cells)}</table>"


def _list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{html.escape(line)}</li>' for line in lines)}</ul>"
