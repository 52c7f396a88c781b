# SPDX-License-Identifier: Apache-2.0
"""Recordings of a task to a LeRobot dataset (v3.0), and the dataset held against them: the same numbers, bit by bit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.lerobot_layout import (
    ACTION,
    BOOKKEEPING,
    CHUNK_FILE,
    DATA,
    EPISODES,
    INFO,
    STATE,
    STATS,
    SURROUNDINGS,
    TASKS,
    VERSION,
    VISIBLE,
    parquet,
)
from tpgmm_ros.recordings.conversion.lerobot_reading import TIME, read_dataset
from tpgmm_ros.recordings.recording import Recording

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
LARGEST_MB = 100
CHUNK = 1000
"""Size of a file at which the next one is begun, and files of a folder, as LeRobot has them."""
_QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)


def features_of(recording: Recording, joints: Sequence[str]) -> dict[str, tuple[Array, tuple[str, ...]]]:
    """What a dataset has of a recording.

    Parameters
    ----------
    recording
        at a steady rate
    joints
        names of those in its configurations

    Returns
    -------
    dict[str, tuple[Array, tuple[str, ...]]]
        feature → values (T, n) and the names of the n numbers
    """
    T = len(recording.times)
    positions = np.empty((T, 0)) if recording.configurations is None else recording.configurations
    found: dict[str, tuple[Array, tuple[str, ...]]] = {
        STATE: (np.hstack([recording.movement, positions]), (*POSE, *joints)),
        ACTION: (recording.movement[np.minimum(np.arange(T) + 1, T - 1)], POSE),
    }
    if recording.frames:
        names = tuple(f"{name}.{one}" for name in recording.frames for one in POSE)
        found[SURROUNDINGS] = np.hstack(list(recording.frames.values())), names
        found[VISIBLE] = np.column_stack(list(recording.visible.values())), tuple(recording.frames)
    return found


def write_dataset(
    folder: Path,
    recordings: Sequence[Recording],
    fps: int,
    text: str,
    joints: Sequence[str] = (),
    progress: Callable[[], object] = lambda: None,
) -> Path:
    """Write recordings as a dataset, each as an episode, and hold it against them.

    Parameters
    ----------
    folder
        of the dataset, which does not exist yet
    recordings
        one or more of the same task, at a steady rate: see `resampling`
    fps
        that rate, Hz
    text
        what is done, in words
    joints
        names of those in their configurations
    progress
        called after each recording

    Returns
    -------
    Path
        the folder

    Raises
    ------
    ConversionError
        pyarrow is missing, or the dataset does not hold what was written.
    OSError
        the disk does not take it, or there is something at `folder`.
    """
    parquet()
    if folder.exists():
        raise FileExistsError(f"{folder} exists, and is not overwritten: move it, or name another folder")
    draft = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(draft, ignore_errors=True)
    try:
        for place in (EPISODES, DATA):
            (draft / place).mkdir(parents=True)
        _write(draft, recordings, fps, text, joints, progress)
        _audit(draft, recordings, joints)
        draft.rename(folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    return folder


def _write(
    folder: Path,
    recordings: Sequence[Recording],
    fps: int,
    text: str,
    joints: Sequence[str],
    progress: Callable[[], object],
) -> None:
    import pyarrow as pa

    rows: list[dict[str, Any]] = []
    totals: dict[str, list[Array]] = {}
    writer, number, first = None, -1, 0
    try:
        for k, recording in enumerate(recordings):
            if writer is None or _path(folder, DATA, number).stat().st_size >= LARGEST_MB * 2**20:
                if writer is not None:
                    writer.close()
                number, writer = number + 1, None
            values = {name: found for name, (found, _) in features_of(recording, joints).items()} | _bookkeeping(
                k, first, recording.times
            )
            table = pa.table({name: _column(name, found) for name, found in values.items()})
            if writer is None:
                path = _path(folder, DATA, number)
                path.parent.mkdir(exist_ok=True)
                writer = parquet().ParquetWriter(path, table.schema, compression="snappy")
            writer.write_table(table)  # a row group for each episode
            row = {"episode_index": k, "tasks": [text], "length": len(recording.times)}
            row |= dict(zip(("data/chunk_index", "data/file_index"), divmod(number, CHUNK), strict=True))
            row |= {"dataset_from_index": first, "dataset_to_index": first + len(recording.times)}
            row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
            for name, found in values.items():
                row |= {f"stats/{name}/{kind}": numbers for kind, numbers in _statistics(found).items()}
                totals.setdefault(name, []).append(found)
            rows.append(row)
            first += len(recording.times)
            progress()
    finally:
        if writer is not None:
            writer.close()
    path = _path(folder, EPISODES, 0)
    path.parent.mkdir()
    parquet().write_table(pa.Table.from_pylist(rows), path, compression="snappy")
    parquet().write_table(_tasks(text), folder / TASKS)
    _json(folder / STATS, {name: _statistics(np.concatenate(found)) for name, found in totals.items()})
    _json(folder / INFO, _info(recordings, fps, joints))


def _path(folder: Path, kind: Path, number: int) -> Path:
    chunk, file = divmod(number, CHUNK)
    return folder / kind / CHUNK_FILE.format(chunk_index=chunk, file_index=file)


def _bookkeeping(number: int, first: int, times: Array) -> dict[str, Any]:
    T = len(times)
    return {
        TIME: times.astype(np.float32),
        "frame_index": np.arange(T),
        "episode_index": np.full(T, number),
        "index": first + np.arange(T),
        "task_index": np.zeros(T, np.int64),
    }


def _column(name: str, values: Array) -> Any:
    """Scalars where a sample has one number, else lists of a fixed size."""
    import pyarrow as pa

    if values.ndim == 1 or values.shape[1] == 1:
        return pa.array(values.reshape(-1))
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _statistics(values: Array) -> dict[str, list[float]]:
    numbers = values.reshape(len(values), -1).astype(float)
    found = {
        "min": numbers.min(axis=0),
        "max": numbers.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
    } | {f"q{round(100 * q):02d}": np.quantile(numbers, q, axis=0) for q in _QUANTILES}
    return {kind: one.tolist() for kind, one in found.items()} | {"count": [len(numbers)]}


def _tasks(text: str) -> Any:
    """The text is the index of a data frame, which pandas knows by what stands in the schema."""
    import pyarrow as pa

    def about(name: str, kind: str, numpy_type: str) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_type, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [about("task_index", "int64", "int64"), about("task", "unicode", "object")],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [text]})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _info(recordings: Sequence[Recording], fps: int, joints: Sequence[str]) -> Mapping[str, Any]:
    features: dict[str, Any] = {
        name: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": list(names)}
        for name, (values, names) in features_of(recordings[0], joints).items()
    }
    features |= {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in BOOKKEEPING.items()}
    return {
        "codebase_version": VERSION,
        "fps": fps,
        "features": features,
        "total_episodes": len(recordings),
        "total_frames": sum(len(one.times) for one in recordings),
        "total_tasks": 1,
        "chunks_size": CHUNK,
        "data_files_size_in_mb": LARGEST_MB,
        "video_files_size_in_mb": 200,
        "data_path": f"{DATA}/{CHUNK_FILE}",
        "video_path": None,
        "robot_type": None,
        "splits": {"train": f"0:{len(recordings)}"},
    }


def _json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=4) + "\n")


def _audit(folder: Path, recordings: Sequence[Recording], joints: Sequence[str]) -> None:
    """Read all of it back, and hold it against what was written."""
    wanted = features_of(recordings[0], joints)
    found = read_dataset(folder, wanted)
    if len(found) != len(recordings):
        raise ConversionError(f"{folder}: holds {len(found)} episodes, {len(recordings)} were written; report it")
    for k, (episode, recording) in enumerate(zip(found, recordings, strict=True)):
        expected = {name: values for name, (values, _) in features_of(recording, joints).items()}
        expected[TIME] = recording.times[:, None]
        if VISIBLE in expected:
            unseen = np.repeat(expected[VISIBLE] == 0, len(POSE), axis=1)
            expected[SURROUNDINGS] = np.where(unseen, np.nan, expected[SURROUNDINGS])
        for name, values in expected.items():
            if not np.array_equal(episode.table[name], values.astype(float), equal_nan=True):
                raise ConversionError(f"{folder}: episode {k} does not hold the {name} that was written; report it")
