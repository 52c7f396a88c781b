# SPDX-License-Identifier: Apache-2.0
"""LeRobot datasets (v3.0) as tables, one for each episode. All that it says of itself is held against what it holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.lerobot_layout import (
    BOOKKEEPING,
    DATA,
    EPISODES,
    INFO,
    MOST_ROWS,
    SURROUNDINGS,
    VISIBLE,
    Feature,
    Info,
    parquet,
)
from tpgmm_ros.recordings.conversion.tables import Table

TIME = "timestamp"
_TIME_TOLERANCE_S = 1e-4
"""What LeRobot itself takes for the same time; numbers of 32 bits have more after some minutes."""
_LFS = b"version https://git-lfs"


@dataclass(frozen=True, slots=True)
class Episode:
    """A demonstration of a dataset.

    Attributes
    ----------
    table
        arrays (T, k) by the names of features, and by feature.name of single numbers; `timestamp` in s
    notes
        what was done, and what was taken for granted, in words
    """

    table: Table
    notes: tuple[str, ...]


def read_dataset(folder: Path, wanted: Collection[str]) -> list[Episode]:
    """Read a dataset.

    Parameters
    ----------
    folder
        with meta/ and data/
    wanted
        features, or feature.name of single numbers; pictures and texts are not read

    Returns
    -------
    list[Episode]
        in the order of their numbers. Where frames.visible says that a frame was not seen, its numbers in
        observation.environment_state are NaN

    Raises
    ------
    ConversionError
        pyarrow is missing, the dataset is of another version, is damaged or incomplete, or has no such features.
    """
    parquet()
    info = Info.of(folder)
    features = _wanted(folder, info, wanted)
    tasks = _announced(folder, info)
    parts: dict[int, list[dict[str, Array]]] = {}
    for path, file in _files(folder, DATA, info.frames):
        columns = _columns(path, file, {**features, **{name: info.features[name] for name in BOOKKEEPING}})
        numbers = columns["episode_index"][:, 0]
        bounds = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        for first, stop in zip(bounds, bounds[1:], strict=False):
            if first < stop:
                part = {name: values[first:stop] for name, values in columns.items()}
                parts.setdefault(int(numbers[first]), []).append(part)
    found = []
    for number in sorted(tasks):
        pieces = parts.pop(number, [])
        rows = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]} if pieces else {}
        length = len(rows[TIME]) if rows else 0
        if length != tasks[number][0]:
            raise ConversionError(
                f"{folder}: {EPISODES} announces {tasks[number][0]} samples of episode {number}, {DATA} holds "
                f"{length}: it was not downloaded whole, or is damaged"
            )
        if not (rows["frame_index"][:, 0] == np.arange(length)).all():
            raise ConversionError(f"{folder}: the samples of episode {number} are not in order: frame_index leaps")
        found.append(_episode(info, features, rows, tasks[number][1]))
    if parts:
        raise ConversionError(f"{folder}: {DATA} holds episode {min(parts)}, which {EPISODES} does not announce")
    return found


def _wanted(folder: Path, info: Info, wanted: Collection[str]) -> dict[str, Feature]:
    """Features that hold what is wanted, and what tells whether it was seen."""
    there = {name: feature for name, feature in info.features.items() if feature.is_vector}
    singles = {f"{name}.{one}": name for name, feature in there.items() for one in feature.names}
    found = {}
    for name in wanted:
        key = name if name in info.features else singles.get(name)
        if key is None:
            raise ConversionError(
                f"{folder}: has no feature {shown(name)}; there are "
                f"{listed([f'{key}[{feature.shape[0]}]' for key, feature in there.items()], 20)}"
            )
        if key not in there:
            feature = info.features[key]
            raise ConversionError(
                f"{folder}: {shown(name)} is of {one_line(feature.dtype, 30)} {feature.shape}, expected numbers along "
                "one axis"
            )
        found[key] = there[key]
    if SURROUNDINGS in found and VISIBLE in there and set(there[VISIBLE].names):
        found[VISIBLE] = there[VISIBLE]
    return found


def _announced(folder: Path, info: Info) -> dict[int, tuple[int, tuple[str, ...]]]:
    """How many samples each episode has, and what is done in it, in words."""
    found: dict[int, tuple[int, tuple[str, ...]]] = {}
    for path, file in _files(folder, EPISODES, info.episodes):
        one = Feature("int64", (1,))
        columns = _columns(path, file, {"episode_index": one, "length": one})
        texts = _texts(path, file, "tasks") if "tasks" in file.schema_arrow.names else [()] * file.metadata.num_rows
        for number, length, text in zip(
            columns["episode_index"][:, 0].tolist(), columns["length"][:, 0].tolist(), texts, strict=True
        ):
            if number in found:
                raise ConversionError(f"{path}: announces episode {number:g} twice")
            found[int(number)] = int(length), text
    if (total := sum(length for length, _ in found.values())) != info.frames:
        raise ConversionError(f"{folder}: {INFO} announces {info.frames} samples, {EPISODES} {total}")
    return found


def _files(folder: Path, kind: Path, rows: int) -> Iterator[tuple[Path, Any]]:
    """Files of a part of a dataset in their order, opened; together they have so many rows."""
    paths = sorted((folder / kind).glob("*/*.parquet"))
    if not paths:
        raise ConversionError(f"{folder}: has no files {kind}/*/*.parquet: it was not downloaded whole")
    came = 0
    for path in paths:
        try:
            with path.open("rb") as begin:
                if begin.read(len(_LFS)) == _LFS:
                    raise ConversionError(f"{path}: is a pointer of Git LFS, no data: run 'git lfs pull' where it lies")
            file = parquet().ParquetFile(path)
            came += file.metadata.num_rows
        except ConversionError:
            raise
        except Exception as error:  # of damaged files, pyarrow raises many things
            raise _damaged(path, error) from None
        if came > min(rows, MOST_ROWS):
            break
        with file:
            yield path, file
    if came != rows:
        raise ConversionError(
            f"{folder}: {INFO} announces {rows} rows of {kind}, and {'more' if came > rows else came} are there: it "
            "was not downloaded whole, or is damaged"
        )


def _columns(path: Path, file: Any, features: Mapping[str, Feature]) -> dict[str, Array]:
    """Columns (T, k) of a file; each is read only where it is no longer than its feature allows."""
    rows = file.metadata.num_rows
    missing = [name for name in features if name not in file.schema_arrow.names]
    if missing:
        raise ConversionError(f"{path}: lacks the columns {listed(missing)}, which {INFO} names")
    try:
        claimed: Counter[str] = Counter()
        for group in range(file.metadata.num_row_groups):
            about = file.metadata.row_group(group)
            for k in range(about.num_columns):
                place = about.column(k).path_in_schema
                claimed.update({n: about.column(k).num_values for n in features if f"{place}.".startswith(f"{n}.")})
        for name, feature in features.items():
            if claimed[name] > rows * feature.shape[0]:
                raise ConversionError(f"{path}: {name} holds other samples than of {feature.shape[0]} numbers")
        table = file.read(columns=list(features), use_threads=False)
        return {name: _numbers(path, name, table.column(name), feature) for name, feature in features.items()}
    except ConversionError:
        raise
    except Exception as error:  # of damaged files, pyarrow raises many things
        raise _damaged(path, error) from None


def _numbers(path: Path, name: str, column: Any, feature: Feature) -> Array:
    import pyarrow as pa
    import pyarrow.compute as pc

    width = feature.shape[0]
    values = column.combine_chunks()
    if hasattr(values, "num_chunks"):  # more than fits into one
        values = pa.concat_arrays(values.chunks)
    is_list = any(
        check(values.type) for check in (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    )
    lengths = pc.list_value_length(values).to_numpy(zero_copy_only=False) if is_list else np.ones(len(values))
    if (is_list and values.null_count) or (lengths != width).any():
        raise ConversionError(f"{path}: {name} holds samples that are not of {width} numbers")
    flat = values.flatten() if is_list else values
    kinds = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean)
    if not any(check(flat.type) for check in kinds):
        raise ConversionError(f"{path}: {name} is of {one_line(flat.type, 40)}, expected numbers")
    numbers = flat.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)  # what is missing becomes NaN
    return np.asarray(numbers, float).reshape(len(values), width)


def _texts(path: Path, file: Any, name: str) -> list[tuple[str, ...]]:
    try:
        found = file.read(columns=[name], use_threads=False).column(name).to_pylist()
    except Exception as error:
        raise _damaged(path, error) from None
    several = ([text] if isinstance(text, str) else text or [] for text in found)
    return [tuple(one_line(text, 100) for text in texts) for texts in several]


def _damaged(path: Path, error: Exception) -> ConversionError:
    return ConversionError(f"{path}: cannot be read: {one_line(error, 150)}; it is damaged: download it again")


def _episode(info: Info, features: Mapping[str, Feature], rows: dict[str, Array], texts: tuple[str, ...]) -> Episode:
    notes = [f"task: {listed(texts, 5)}"] if texts else []
    exact = np.arange(len(rows[TIME])) / info.fps
    off = float(np.abs(rows[TIME][:, 0] - exact).max())
    if off <= max(_TIME_TOLERANCE_S, float(np.spacing(np.float32(exact[-1])))):
        rows[TIME] = exact[:, None]
    else:
        notes.append(f"timestamps are up to {off:.4f} s away from {info.fps:g} Hz: timestamps are used")
    if VISIBLE in features and SURROUNDINGS in features:
        places = rows[SURROUNDINGS] = rows[SURROUNDINGS].copy()
        for frame, seen in zip(features[VISIBLE].names, rows[VISIBLE].T, strict=True):
            mine = [k for k, name in enumerate(features[SURROUNDINGS].names) if name.rpartition(".")[0] == frame]
            places[np.ix_(seen == 0.0, mine)] = np.nan
    for name, feature in features.items():
        rows |= {f"{name}.{one}": rows[name][:, k] for k, one in enumerate(feature.names)}
    return Episode(rows, tuple(notes))
