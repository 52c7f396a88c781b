# SPDX-License-Identifier: Apache-2.0
"""What a model keeps of its training, beside the numbers: the names of the recordings, and the errors to expect."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tpgmm_core import LearnedMixture
from tpgmm_core.common.text import shown

BAGS, ERRORS, BASES = "bags", "expected_errors", "bases"
"""Keys in the metadata."""
_NAMES = ("position_rmse_m", "position_end_m", "orientation_mean_deg")
MOST_BAGS = 1000
"""Names beyond so many are not kept: a model file is not to grow with its recordings."""


def keep_recordings(model: LearnedMixture, names: Sequence[str]) -> None:
    """Write the names of the recordings into a model that was learned from them."""
    model.metadata_[BAGS] = json.dumps(list(names[:MOST_BAGS]))


def keep_errors(model: LearnedMixture, source: str, path_m: float, end_m: float, turn_deg: float) -> None:
    """Write into a model how far it was off, in the mean, where demonstrations were left out.

    Parameters
    ----------
    model
        to write into
    source
        what found it out, in words
    path_m
        root mean square of the position over the path, m
    end_m
        of the position at the end, m
    turn_deg
        mean angle over the path, deg
    """
    errors = dict(zip(_NAMES, (path_m, end_m, turn_deg), strict=True))
    model.metadata_[ERRORS] = json.dumps({"from": source, **errors})


def forget_errors(model: LearnedMixture) -> None:
    """Take back what `keep_errors` wrote: the model has changed since."""
    model.metadata_.pop(ERRORS, None)


def keep_bases(model: LearnedMixture, path: Path, other: LearnedMixture) -> None:
    """Write into a model of which other model its bases are.

    Parameters
    ----------
    model
        to write into
    path
        of the other model; only its name is kept
    other
        the other model
    """
    said = {name: other.metadata_[name] for name in ("task", "demonstrations") if name in other.metadata_}
    model.metadata_[BASES] = json.dumps({"model": path.name, **said})


def bases_from(model: LearnedMixture) -> dict[str, Any]:
    """`model` (file name), and `task` and `demonstrations` where known, of the model whose bases it has, or nothing.

    Parameters
    ----------
    model
        with metadata

    Returns
    -------
    dict[str, Any]
        by name

    Raises
    ------
    ValueError
        the metadata hold something else there.
    """
    found = _read(model, BASES, {})
    if not isinstance(found, dict) or (found and not isinstance(found.get("model"), str)):
        raise ValueError(f"the model's metadata say {BASES} = {shown(found)}; expected a model by name, train it again")
    return found


def learned_from(model: LearnedMixture) -> tuple[str, ...]:
    """Names of the recordings that a model was learned from; none where it does not say them.

    Parameters
    ----------
    model
        with metadata

    Returns
    -------
    tuple[str, ...]
        in the order of learning

    Raises
    ------
    ValueError
        the metadata hold something else there.
    """
    found = _read(model, BAGS, [])
    if not isinstance(found, list) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"the model's metadata say {BAGS} = {shown(found)}; expected a list of names, train it again")
    return tuple(found)


def expected_errors(model: LearnedMixture) -> dict[str, Any]:
    """Mean errors on demonstrations that were left out, by name; empty where a model does not say them.

    Parameters
    ----------
    model
        with metadata

    Returns
    -------
    dict[str, Any]
        `from`, a text, and position_rmse_m, position_end_m, orientation_mean_deg

    Raises
    ------
    ValueError
        the metadata hold something else there.
    """
    found = _read(model, ERRORS, {})
    if not isinstance(found, dict) or (found and not all(isinstance(found.get(name), float) for name in _NAMES)):
        raise ValueError(f"the model's metadata say {ERRORS} = {shown(found)}; expected errors by name, train it again")
    return found


def _read(model: LearnedMixture, key: str, empty: Any) -> Any:
    text = model.metadata_.get(key)
    if text is None:
        return empty
    try:
        return json.loads(str(text))
    except ValueError:
        raise ValueError(f"the model's metadata say {key} = {shown(text)}; expected JSON, train it again") from None
