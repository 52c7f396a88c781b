# SPDX-License-Identifier: Apache-2.0
"""Small files beside demonstrations and models: JSON, replaced as a whole, read as untrusted input."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Self

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.text import one_line, shown
from tpgmm_core.common.yaml_values import a_number, a_truth, checked_text, expect
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.recipe import LearnedAs

MAX_BYTES = 2_000_000
MAX_COMMENT = 2000


@dataclass(frozen=True, slots=True)
class Correction:
    """What a demonstration corrects.

    Parameters
    ----------
    model
        number of the model that ran
    begin, end
        shares of the movement, 0 to 1, between which the arm was led
    frame
        the frame in which the correction holds; empty where it is not said: then it is found
    """

    model: int
    begin: float
    end: float
    frame: str = ""


@dataclass(frozen=True, slots=True)
class Notes:
    """What is known of a demonstration beside its bag.

    Parameters
    ----------
    comment
        of the user
    trim
        begin and end in s from the first sample, of what is used; None: all of it
    is_used
        whether models learn from it
    is_undone
        whether it was taken back; it is not used then either, and `redo` brings it back
    correction
        None for what was shown from the beginning
    """

    comment: str = ""
    trim: tuple[float, float] | None = None
    is_used: bool = True
    is_undone: bool = False
    correction: Correction | None = None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """From JSON. Raises ValueError for what `write_json` of notes did not write."""
        _refuse_others(values, cls.__dataclass_fields__)
        trim, correction = values.get("trim"), values.get("correction")
        return cls(
            comment=one_line(_text(values.get("comment", "")), MAX_COMMENT),
            trim=None if trim is None else _interval(trim),
            is_used=_truth(values.get("is_used", True)),
            is_undone=_truth(values.get("is_undone", False)),
            correction=None if correction is None else _correction(correction),
        )


@dataclass(frozen=True, slots=True)
class ModelNotes:
    """What is known of a model beside its file.

    Parameters
    ----------
    learned_from
        number of each demonstration -> begin and end (s) of what was used of it, or None for all of it
    words
        how well it does, for people, most important first
    method
        of retrieval
    n_components
        of the model
    errors
        number of each demonstration -> name -> error when it was left out: `path_m`, `turn_deg`, `end_m`, and for each
        observed frame `at <frame>_m`
    misfits
        number of each demonstration that does not fit the others -> why
    seconds
        that training took
    is_undone
        whether it was taken back
    corrects
        number of the model that a correction changed into this one; 0 without one
    learned_as
        method, frames and settings, with which corrections learn
    """

    learned_from: Mapping[int, tuple[float, float] | None]
    words: tuple[str, ...] = ()
    method: str = ""
    n_components: int = 0
    errors: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    misfits: Mapping[int, str] = field(default_factory=dict)
    seconds: float = 0.0
    is_undone: bool = False
    corrects: int = 0
    learned_as: LearnedAs | None = None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """From JSON. Raises ValueError for what `write_json` of notes did not write."""
        _refuse_others(values, cls.__dataclass_fields__)
        learned, learned_as = _mapping(values.get("learned_from")), values.get("learned_as")
        return cls(
            learned_from={_number(k): None if v is None else _interval(v) for k, v in learned.items()},
            words=tuple(one_line(_text(word)) for word in _list(values.get("words", []))),
            method=_text(values.get("method", "")),
            n_components=_number(values.get("n_components", 0)),
            errors={
                _number(k): {_text(name): _real(value) for name, value in _mapping(v).items()}
                for k, v in _mapping(values.get("errors", {})).items()
            },
            misfits={_number(k): one_line(_text(v)) for k, v in _mapping(values.get("misfits", {})).items()},
            seconds=_real(values.get("seconds", 0.0)),
            is_undone=_truth(values.get("is_undone", False)),
            corrects=_number(values.get("corrects", 0)),
            learned_as=None if learned_as is None else LearnedAs.of(_mapping(learned_as)),
        )


def write_notes(path: Path, notes: Notes | ModelNotes) -> None:
    """Write notes as JSON into a file, which is replaced as a whole. Raises OSError."""
    text = json.dumps(asdict(notes), indent=1, allow_nan=False)
    write_atomically(path, lambda draft: draft.write_text(text + "\n"))


def read_notes[KindT: (Notes, ModelNotes)](path: Path, kind: type[KindT]) -> KindT:
    """Read notes.

    Parameters
    ----------
    path
        of the file
    kind
        of the notes

    Returns
    -------
    KindT
        the notes

    Raises
    ------
    ProjectError
        for a file that cannot be read, or holds something else
    """
    try:
        if path.is_symlink() or not path.is_file():
            raise ValueError("is not a regular file")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise ValueError(f"is larger than {MAX_BYTES} bytes")
        return kind.of(_mapping(json.loads(content)))
    except (OSError, ValueError, RecursionError) as error:
        raise ProjectError(
            f"{one_line(path)}: the notes in it cannot be read ({one_line(error)}); correct or remove this "
            "file; the recordings are not affected"
        ) from None


def _refuse_others(values: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    if others := [name for name in values if name not in known]:
        raise ValueError(f"has the unknown key {shown(others[0])}")


def _correction(values: Any) -> Correction:
    found = _mapping(values)
    _refuse_others(found, Correction.__dataclass_fields__)
    begin, end = _interval([found.get("begin"), found.get("end")])
    return Correction(_number(found.get("model")), begin, end, _text(found.get("frame", "")))


def _interval(value: Any) -> tuple[float, float]:
    begin, end = map(_real, _list(value)) if len(_list(value)) == 2 else (0.0, 0.0)
    if not begin < end:
        raise ValueError(f"expected a begin and a later end, got {shown(value)}")
    return begin, end


def _mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"expected names and values, got {shown(value)}")
    return value


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"expected a list, got {shown(value)}")
    return value


_text = partial(expect, checked_text(lambda text: True, "a text"))
_truth = partial(expect, a_truth)
_real = partial(expect, a_number())


def _number(value: Any) -> int:
    """Keys of JSON are texts."""
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"expected a number of a demonstration or model, got {shown(value)}")
    return value
