# SPDX-License-Identifier: Apache-2.0
"""The components of a model, and which frames count in each, as tables and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.common.report import format_table
from tpgmm_core.learning.frame_screen import SHARES
from tpgmm_core.retrieval.segment_frames import SegmentFrames, activations

MOST_COMPONENTS = 30
"""More are in the JSON alone."""


def components_of(model: LearnedMixture) -> list[dict[str, Any]]:
    """Each component of a model, as JSON can hold it: its share of the samples, and its mean in each frame."""
    names = model.dimensions_
    has_time = names is not None and names[0] == "time"
    rows = []
    for k, prior in enumerate(model.priors_):
        means = {name: [round(float(x), 6) for x in model.means_[name][k]] for name in model.frame_names_}
        row: dict[str, Any] = {"prior": float(prior), "means": means}
        if has_time:
            first = model.frame_names_[0]
            row["time_s"] = float(model.means_[first][k, 0])
            row["time_deviation_s"] = float(np.sqrt(model.covariances_[first][k, 0, 0]))
        rows.append(row)
    return rows


def timeline(components: Sequence[Mapping[str, Any]]) -> str:
    """Components of a model over time, in a table."""
    rows = [
        (i, f"{row['time_s']:.2f}", f"{row['time_deviation_s']:.2f}", f"{row['prior']:.3f}")
        for i, row in sorted(enumerate(components), key=lambda item: item[1]["time_s"])
    ]
    more = f"\nand {len(rows) - MOST_COMPONENTS} more: see --json" if len(rows) > MOST_COMPONENTS else ""
    table = format_table(("component", "at s", "spread s", "share of samples"), rows[:MOST_COMPONENTS])
    return f"components:\n{table}{more}"


def segments_of(model: LearnedMixture) -> dict[str, Any] | None:
    """Which frames count in which segment of the movement.

    Parameters
    ----------
    model
        a fitted model

    Returns
    -------
    dict[str, Any] | None
        `prune`, the relevance below which a frame is left out, and for each component the share of the movement `at`
        which it is, and by frame `relevance` and `kept`; None where all frames count everywhere

    Raises
    ------
    ValueError
        metadata that are none of `train`.
    """
    found = SegmentFrames.of_model(model)
    if found is None:
        return None
    shares = np.linspace(0.0, 1.0, SHARES)
    active = activations(model, shares)
    return {
        "prune": found.least,
        "at": (active @ shares / active.sum(axis=1)).tolist(),
        "relevance": {name: values.tolist() for name, values in found.relevance.items()},
        "kept": {name: found.is_kept(name).tolist() for name in found.relevance},
    }


def segments_table(segments: Mapping[str, Any]) -> str:
    """What `segments_of` found, in a table: a row for each segment, in the order of the movement."""
    names, at = list(segments["relevance"]), segments["at"]
    rows = [
        (
            k,
            f"{at[k]:.0%}",
            *(
                f"{'kept' if segments['kept'][name][k] else 'left out'} {segments['relevance'][name][k]:.2f}"
                for name in names
            ),
        )
        for k in sorted(range(len(at)), key=at.__getitem__)
    ]
    title = f"frames that count in each segment (component) of the movement: left out below {segments['prune']:g} of "
    return title + "the precision of the best\n" + format_table(("segment", "at", *names), rows)
