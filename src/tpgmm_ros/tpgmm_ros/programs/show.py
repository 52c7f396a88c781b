# SPDX-License-Identifier: Apache-2.0
"""`show`: what a model file holds: its frames, when each of them counts, what it was learned from, how exact it is."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import counted, listed, one_line
from tpgmm_core.kinematics.method import NAME as KINEMATIC
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.calibrated import scale_key
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.methods import ALL_METHODS, DEFAULT, KEY, load_model
from tpgmm_core.retrieval.novelty import NoveltyScale
from tpgmm_core.retrieval.own_end import KEY as END_KEY
from tpgmm_core.retrieval.relevance import relevance
from tpgmm_core.retrieval.segment_frames import KEY as PRUNE_KEY
from tpgmm_core.retrieval.sub_objectives import quadratic_costs
from tpgmm_ros.models.training_record import bases_from, expected_errors, learned_from
from tpgmm_ros.programs.components import MOST_COMPONENTS, components_of, segments_of, segments_table, timeline
from tpgmm_ros.programs.reporting import JSON, json_text, refuse_foreign
from tpgmm_ros.runtime.entry import a_path

EXAMPLES = """\
examples:
  show pick_place.tpgmm
  show --json pick_place.tpgmm | jq .relevance
  show --costs costs.json pick_place.tpgmm    (the frames' weights over time, for your own solver)

exit status: 0 the file is a model; 1 it is not, the reason is on stderr; 2 wrong arguments
"""
PARTS = 10
COST_TIMES = 101
"""At which costs are written, from the beginning to the end."""
BAR = 30
"""Characters of a bar for a share of 1."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = _parser().parse_args(arguments)
    try:
        model = load_model(options.model)
        found = described(model, options.model)
        if options.costs is not None:
            refuse_foreign(options.costs, JSON, "file of costs")
            text = json.dumps(costs_of(model, found["retrieval"]), allow_nan=False)
            write_atomically(options.costs, lambda file: file.write_text(text))
            print(f"costs: {options.costs}", file=sys.stderr)
    except (OSError, ValueError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        if options.json:
            print(json_text({"passed": False, "error": one_line(error)}))
        return 1
    print(json_text(found) if options.json else _text(found))
    return 0


def described(model: LearnedMixture, path: Path) -> dict[str, Any]:
    """What a model says of itself, as JSON can hold it.

    Parameters
    ----------
    model
        a fitted model
    path
        its file

    Returns
    -------
    dict[str, Any]
        texts and numbers by name

    Raises
    ------
    ValueError
        metadata that are none of `train`.
    """
    said = model.metadata_
    method = str(said.get(KEY, DEFAULT))
    found: dict[str, Any] = {
        "model": str(path),
        "bytes": path.stat().st_size,
        "kind": type(model).__name__,
        "retrieval": method,
        "encodes": _encodes(method),
        "task": said.get("task"),
        "base_frame": said.get("base_frame"),
        "movement": said.get("movement"),
        "endpoint": said.get("endpoint"),
        "duration_s": said.get("duration_s"),
        "demonstrations": said.get("demonstrations"),
        "samples": said.get("samples"),
        "learned_from": list(learned_from(model)),
        "manifold": str(model.manifold_),
        "dimensions": list(model.dimensions_ or ()),
        "covariance": model.emissions_.structure.name,
        "bases": _bases(model),
        "iterations": int(model.n_iter_),
        "converged": bool(model.converged_),
        "log_likelihood": float(model.log_likelihood_),
        "exact": said.get("exact"),
        "frames": _frames(model),
        "components": components_of(model),
    }
    if isinstance(model, TimeStepTPGMM) and model.modes_.any():
        found["ways"] = model.modes_.tolist()
    if isinstance(model, PeriodicTPGMM):
        found |= {"period_s": model.period_, "cycles": model.cycles_}
    try:
        shares = _relevance(model, method)
        found["relevance"] = {"along": shares[0], "shares": shares[1]}
    except ValueError as error:
        found["no_relevance_because"] = str(error)
    found["calibrated"] = {name: float(said[scale_key(name)]) for name in ALL_METHODS if scale_key(name) in said}
    scale = NoveltyScale.of_model(model)
    if scale is not None:
        found["novelty"] = {"contradictions": list(scale.contradictions), "distances": list(scale.distances)}
    found["expected_errors"] = expected_errors(model)
    segments = segments_of(model)
    if segments is not None:
        found["segments"] = segments
    of_frames = {f"{key}.{name}" for key in (PRUNE_KEY, END_KEY) for name in model.frame_names_}
    known = {
        KEY,
        "bags",
        "expected_errors",
        "novelty",
        "derived_frames",
        *map(scale_key, ALL_METHODS),
        PRUNE_KEY,
        *of_frames,
        *found,
    }
    found["other_metadata"] = {key: value for key, value in said.items() if key not in known}
    return found


def costs_of(model: LearnedMixture, method: str) -> dict[str, Any]:
    """The quadratic costs of a model's frames at COST_TIMES times of the movement, as JSON can hold them.

    Parameters
    ----------
    model
        a fitted model
    method
        what it was learned for

    Returns
    -------
    dict[str, Any]
        see `quadratic_costs`; `duration_s` and `base_frame` beside

    Raises
    ------
    ValueError
        for a model whose frames are no places, or that is not over time
    """
    if method == KINEMATIC:
        raise ValueError("no costs: kinematic frames depend on the posture of the robot, so their costs are not fixed")
    duration = demonstrated_duration(model)
    known = {"duration_s": duration, "base_frame": model.metadata_.get("base_frame")}
    return {**known, **quadratic_costs(model, np.linspace(0.0, duration, COST_TIMES))}


def _encodes(method: str) -> str:
    return ALL_METHODS[method].encoding.description if method in ALL_METHODS else "configurations of joints"


def _bases(model: LearnedMixture) -> str | None:
    """Whose bases a model was learned with, in words; None for its own, or none."""
    if not model.emissions_.structure.fixed_bases:
        return None
    said = bases_from(model)
    source = f"those of {said['model']}" if said else "given"
    more = [f"task {said['task']}"] if "task" in said else []
    more += [counted(said["demonstrations"], "demonstration")] if "demonstrations" in said else []
    return source + (f" ({', '.join(more)})" if more else "") + ", not learned"


def _frames(model: LearnedMixture) -> dict[str, str]:
    """What each frame is."""
    derived = DerivedFrames.of_metadata(model.metadata_).sources
    return {name: str(derived[name]) if name in derived else "of the task" for name in model.frame_names_}


def _relevance(model: LearnedMixture, method: str) -> tuple[str, dict[str, list[float]]]:
    if method == KINEMATIC:
        raise ValueError("kinematic frames: how much each counts depends on the posture of the robot")
    shares = relevance(model, PARTS)
    return shares.along, {name: [float(x) for x in values] for name, values in shares.shares.items()}


def _text(found: Mapping[str, Any]) -> str:
    learned = f"{counted(found['demonstrations'] or '?', 'demonstration')}, {found['samples'] or '?'} samples"
    if found["learned_from"]:
        learned += f": {listed(found['learned_from'])}"
    components = counted(len(found["components"]), "component")
    rows = {
        "model": f"{found['kind']}, {components}, {found['covariance']} covariances",
        "bases": found["bases"],
        "retrieval": f"{found['retrieval']}, of {found['encodes']}",
        "task": found["task"],
        "hand": _of_hand(found),
        "learned from": learned,
        "duration": f"{found['duration_s']:.2f} s" if found["duration_s"] else None,
        "period": f"{found['period_s']:.2f} s, of {found['cycles']} cycles" if "period_s" in found else None,
        "log-likelihood": f"{found['log_likelihood']:.4f} per sample after {found['iterations']} iterations"
        + ("" if found["converged"] else " (not converged)"),
        "met exactly": found["exact"],
        "file": f"{found['model']}, {found['bytes'] / 1000:.0f} kB",
    }
    parts = [format_table(("what", "value"), [row for row in rows.items() if row[1]])]
    parts.append(format_table(("frame", "what it is"), found["frames"].items()))
    parts.append(_bars(found))
    if any("time_s" in row for row in found["components"]):
        parts.append(timeline(found["components"]))
    if "segments" in found:
        parts.append(segments_table(found["segments"]))
    parts.append(_exactness(found))
    if found["other_metadata"]:
        parts.append(
            format_table(("also says", "value"), [(k, one_line(v, 80)) for k, v in found["other_metadata"].items()])
        )
    return "\n\n".join(parts)


def _of_hand(found: Mapping[str, Any]) -> str | None:
    if not found["endpoint"]:
        return None
    return f"{found['endpoint']}, from {found['movement']}, in {found['base_frame']}"


def _bars(found: Mapping[str, Any]) -> str:
    """When each frame counts, as bars of text."""
    if "relevance" not in found:
        return f"when each frame counts is not shown: {found['no_relevance_because']}"
    along, shares = found["relevance"]["along"], found["relevance"]["shares"]
    names = list(shares)
    n = len(shares[names[0]])
    words = (
        f"in each tenth of the {'cycle' if 'period_s' in found else 'movement'}"
        if along == "movement"
        else "in each component"
    )
    rows = []
    for i in range(min(n, MOST_COMPONENTS)):
        label = f"{100 * i // n} to {100 * (i + 1) // n} %" if along == "movement" else str(i)
        rows.append(
            (label, *(f"{shares[name][i]:.2f} {'█' * round(shares[name][i] * BAR / len(names) * 2)}" for name in names))
        )
    title = f"how much each frame determines the pose of the hand, {words} (shares):\n"
    return title + format_table(("", *names), rows)


def _exactness(found: Mapping[str, Any]) -> str:
    """What is known of how exact the model is."""
    lines = [
        f"calibrated for {name}: covariances are scaled by {scale:.2f}, standard deviations by {scale**0.5:.2f}"
        for name, scale in found["calibrated"].items()
    ] or ["not calibrated: 'train --leave-one-out --output' measures how exact the covariances are"]
    if errors := found["expected_errors"]:
        lines.append(
            f"expected error in new situations ({errors['from']}): {errors['position_rmse_m']:.3f} m over the path, "
            f"{errors['position_end_m']:.3f} m at the end, {errors['orientation_mean_deg']:.1f} deg"
        )
    else:
        lines.append("expected errors are not known: the model was not tested on demonstrations that were left out")
    if "novelty" in found:
        usual = max(found["novelty"]["distances"])
        lines.append(
            f"novelty of situations is judged against {len(found['novelty']['distances'])} demonstrations that "
            f"were left out, up to {usual:.2g} standard deviations from the others"
        )
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="show",
        description="Show the content of a model file: frames and when each counts, how it was learned, its accuracy.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("model", metavar="MODEL", type=a_path, help="model file, such as task.tpgmm")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument(
        "--costs",
        metavar="FILE",
        type=a_path,
        help="write the frames' quadratic costs over time as JSON, for another solver",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
