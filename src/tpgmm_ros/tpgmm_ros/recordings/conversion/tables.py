# SPDX-License-Identifier: Apache-2.0
"""Files with numbers as tables, one for each demonstration: name → array (T, k). Nothing in a file is executed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse

from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.csv_file import read_csv
from tpgmm_ros.recordings.finding import PACKED

_PICKLED = np.array("Python objects (pickle), which are never loaded")
MATRICES = (4, 4), (3, 4)
"""Shapes of transforms, with and without their row 0 0 0 1."""
MOST_OF_SPARSE = 50_000_000
"""Numbers of a sparse matrix, with all its zeros."""

type Table = Mapping[str, Array]
"""Arrays (T, k) by name; a single array without a name is called ""."""


def read_tables(path: Path, wanted: Collection[str], labels: str | None = None) -> list[Table]:
    """Read a file.

    Parameters
    ----------
    path
        .csv, .tsv, .txt, .npy, .npz or .mat
    wanted
        names of the arrays that are used: these tell how many demonstrations there are
    labels
        name of a column of a text file that may hold texts

    Returns
    -------
    list[Table]
        one for each demonstration of the file: for each element of its arrays of structs or cells, and of the first
        axis of numpy arrays with three axes (the last one in MATLAB); else a single one

    Raises
    ------
    ConversionError
        the file is none of these, is damaged, or holds no numbers.
    """
    readers: dict[str, Callable[[Path], dict[str, Any]]] = {
        **dict.fromkeys((".csv", ".tsv", ".txt"), partial(read_csv, wanted=wanted, labels=labels)),
        ".npy": _npy,
        ".npz": _npz,
        ".mat": _mat,
    }
    if not path.exists():
        raise ConversionError(f"{path}: does not exist")
    reader = readers.get(path.suffix.lower())
    if reader is None:
        hint = "; unpack it first" if path.name.lower().endswith(PACKED) else ""
        raise ConversionError(f"{path}: is of no known kind; expected {listed(list(readers))}{hint}")
    try:
        return _tables(path, reader(path), wanted, is_matlab=path.suffix.lower() == ".mat")
    except ConversionError:
        raise
    except NotImplementedError:
        raise ConversionError(
            f"{path}: is a MATLAB file of version 7.3 (HDF5), which is not read; write it by save('{path.name}', '-v7')"
        ) from None
    except Exception as error:  # of damaged files, their readers raise many things
        why = one_line(error, 200)
        if "allow_pickle" in why:
            why = "it holds Python objects (pickle), which are never loaded; save arrays of numbers"
        raise ConversionError(f"{path}: cannot be read: {why}") from None


def _npy(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        found = np.load(file, allow_pickle=False)
        if more := len(file.read()):
            raise ConversionError(
                f"{path}: goes on for {more} bytes behind its array, as where several were saved into one file: save "
                "each into its own, or all by numpy.savez"
            )
    return _fields("", found)


def _npz(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        return {key: value for name in file.files for key, value in _fields(f"{name}.", _member(file, name)).items()}


def _member(file: Any, name: str) -> Any:
    """An array of a file, or what shows that it holds Python objects, which may stand there as long as nobody asks."""
    try:
        return file[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        return _PICKLED


def _fields(prefix: str, value: Any) -> dict[str, Any]:
    """An array by its name, or the fields of a structured one, as `np.genfromtxt(names=True)` makes them."""
    if not value.dtype.names:
        return {prefix.removesuffix("."): value}
    return {f"{prefix}{field}": value[field] for field in value.dtype.names}


def _mat(path: Path) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what is no number, such as functions, which is not wanted
        found = scipy.io.loadmat(path)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _tables(path: Path, values: Mapping[str, Any], wanted: Collection[str], is_matlab: bool) -> list[Table]:
    shared: dict[str, Array] = {}
    several: dict[str, list[Array]] = {}
    found = _numbers(values.items())
    if odd := sorted(
        (values.keys() & set(wanted)) - {name.partition(".")[0] for name, _ in found} - dict(found).keys()
    ):
        raise ConversionError(f"{path}: {odd[0] or 'its array'} holds {_words(values[odd[0]])}; save arrays of numbers")
    for name, value in found:
        if isinstance(value, list):
            several[name] = value
        elif value.ndim == 4:
            several[name] = list(np.moveaxis(value, (3, 2), (0, 1)) if is_matlab else value)
        elif value.ndim == 3 and value.shape[-2:] not in MATRICES and not (is_matlab and value.shape[:2] in MATRICES):
            several[name] = list(np.moveaxis(value, -1, 0) if is_matlab else value)
        else:
            shared[name] = np.moveaxis(value, -1, 0) if is_matlab and value.ndim == 3 else value
    if not shared and not several:
        what = f"; it holds {_words(values[''])}" if set(values) == {""} else ""
        raise ConversionError(f"{path}: holds no arrays of numbers{what}")
    counts = {name: len(value) for name, value in several.items() if name in wanted}
    if len(set(counts.values())) > 1:
        there = listed([f"{name} has {count}" for name, count in counts.items()])
        raise ConversionError(f"{path}: has different numbers of demonstrations: {there}")
    count = next(iter(counts.values()), 1)
    kept = {name: value for name, value in several.items() if len(value) == count}
    return [{**shared, **{name: value[i] for name, value in kept.items()}} for i in range(count)]


def _numbers(items: Iterable[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """Arrays of numbers by name; of arrays of structs or cells, lists of arrays."""
    found: list[tuple[str, Any]] = []
    for name, value in items:
        if scipy.sparse.issparse(value):
            if np.prod(value.shape, dtype=float) > MOST_OF_SPARSE:
                continue
            value = value.toarray()
        value = np.asarray(value)
        if value.dtype.kind in "mM":  # times and durations: seconds from the first on
            value = (value - value.ravel()[:1]) / np.timedelta64(1, "s") if value.size else value.astype(float)
        if value.dtype.names:  # structs
            elements = value.ravel()
            for field in value.dtype.names:
                found += _joined(f"{name}.{field}", [element[field] for element in elements])
        elif value.dtype == object and value.ndim:  # cells
            found += _joined(name, list(value.ravel()))
        elif value.dtype.kind in "fiub" and value.size and _has_axes(value):
            found.append((name, value.astype(float)))
    return found


def _has_axes(value: Any) -> bool:
    return value.ndim in (1, 2, 3) or (value.ndim == 4 and 4 in (value.shape[-1], value.shape[0]))


def _words(value: Any) -> str:
    """What an array is that is not of numbers, in words."""
    if value is _PICKLED:
        return str(value)
    if scipy.sparse.issparse(value):
        return f"a sparse matrix of {value.shape}, which is too large"
    value = np.asarray(value)
    return f"no real numbers along one to three axes, but {value.dtype} of the shape {value.shape}"


def _joined(name: str, elements: list[Any]) -> list[tuple[str, Any]]:
    """What is within elements of the same kind, as lists; a single one is itself."""
    if len(elements) == 1:
        return _numbers([(name, elements[0])])
    inner = [_numbered(dict(_numbers([(name, element)]))) for element in elements]
    names = [key for key in inner[0] if all(key in one for one in inner)]
    return [(key, [one[key] for one in inner]) for key in names]


def _numbered(values: Mapping[str, Any]) -> dict[str, Array]:
    """Lists within demonstrations as arrays of their own: frames(1), frames(2), as MATLAB counts."""
    found: dict[str, Array] = {}
    for name, value in values.items():
        found |= {f"{name}({i})": one for i, one in enumerate(value, 1)} if isinstance(value, list) else {name: value}
    return found
