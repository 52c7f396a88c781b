# SPDX-License-Identifier: Apache-2.0
"""What lies where in a LeRobot dataset (v3.0), and what its meta/info.json says. Nothing in it is executed.

meta/info.json                               rate, features, counts
meta/stats.json                              statistics of the features
meta/tasks.parquet                           what is done, in words
meta/episodes/chunk-000/file-000.parquet     a row for each episode
data/chunk-000/file-000.parquet              a row for each sample, episodes one after the other
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError

VERSION = "v3.0"
INFO = Path("meta", "info.json")
STATS = Path("meta", "stats.json")
TASKS = Path("meta", "tasks.parquet")
EPISODES = Path("meta", "episodes")
DATA = Path("data")
CHUNK_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
STATE, SURROUNDINGS, ACTION, VISIBLE = "observation.state", "observation.environment_state", "action", "frames.visible"
"""Features that are written; the last one is no name of LeRobot's: which frames were seen."""
_INDICES = {"frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64"}
BOOKKEEPING = {"timestamp": "float32", **_INDICES}
"""Features that every dataset has, each of one number, and their types."""
_LARGEST_INFO = 16 * 1024 * 1024
MOST_ROWS = 50_000_000
"""More samples are not read at once: what little files claim to hold must not fill the memory."""
_DTYPE = re.compile(r"(u?int|float)(8|16|32|64)|bool")


@dataclass(frozen=True, slots=True)
class Feature:
    """Numbers that a dataset has of each sample.

    Attributes
    ----------
    dtype
        of one number
    shape
        of a sample; scalars have (1,)
    names
        of the numbers of a feature with one axis; empty where it has none
    """

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] = ()

    @property
    def is_vector(self) -> bool:
        """Whether it is of numbers along one axis: no picture, no text."""
        return _DTYPE.fullmatch(self.dtype) is not None and len(self.shape) == 1


@dataclass(frozen=True, slots=True)
class Info:
    """What meta/info.json says.

    Attributes
    ----------
    fps
        samples per second, Hz
    features
        by name
    episodes, frames
        how many episodes, and how many samples of all of them
    """

    fps: float
    features: Mapping[str, Feature]
    episodes: int
    frames: int

    @classmethod
    def of(cls, folder: Path) -> Info:
        """Read it.

        Returns
        -------
        Info
            what it says

        Raises
        ------
        ConversionError
            it is missing, damaged, of another version, or says what cannot be.
        """
        path = folder / INFO
        try:
            with path.open("rb") as file:
                content = json.loads(file.read(_LARGEST_INFO))
        except OSError as error:
            raise ConversionError(f"{folder}: is no LeRobot dataset: {INFO}: {error.strerror}") from None
        except (ValueError, RecursionError) as error:
            raise ConversionError(f"{path}: is damaged: {one_line(error, 100)}; download it again") from None
        version = content.get("codebase_version") if isinstance(content, dict) else None
        if not isinstance(version, str) or not version.startswith("v3."):
            how = "; LeRobot's own convert_dataset_v21_to_v30 turns v2.1 into v3.0" if str(version)[:2] == "v2" else ""
            raise ConversionError(f"{path}: is of the version {shown(version)}, expected {VERSION}{how}")
        try:
            fps, episodes, frames = float(content["fps"]), content["total_episodes"], content["total_frames"]
            features = {str(name): _feature(value) for name, value in content["features"].items()}
            if not math.isfinite(fps) or fps <= 0.0:
                raise ValueError(f"fps is {fps}, expected a rate above 0 in Hz")
            for name, count in (("total_episodes", episodes), ("total_frames", frames)):
                if type(count) is not int or not 0 < count <= MOST_ROWS:
                    raise ValueError(f"{name} is {shown(count)}, expected a number from 1 to {MOST_ROWS}")
        except KeyError as error:
            raise ConversionError(f"{path}: lacks {one_line(error, 60)}; download it again") from None
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            raise ConversionError(f"{path}: cannot be understood: {one_line(error, 150)}") from None
        missing = [name for name in BOOKKEEPING if name not in features]
        if missing:
            raise ConversionError(f"{path}: lacks the features {listed(missing)}, which every dataset has")
        return cls(fps, features, episodes, frames)


def is_dataset(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset, of whatever version."""
    return (path / INFO).is_file()


def _feature(value: Mapping[str, Any]) -> Feature:
    shape = tuple(value["shape"])
    if not all(type(size) is int and 0 < size <= 1_000_000 for size in shape):
        raise ValueError(f"a feature has the shape {shown(shape)}")
    names = value.get("names")
    if isinstance(names, dict):  # {"motors": [...]}
        names = next(iter(names.values()), None) if len(names) == 1 else None
    given = tuple(map(str, names)) if isinstance(names, list) and shape == (len(names),) else ()
    return Feature(str(value["dtype"]), shape, given if len(set(given)) == len(given) else ())


def parquet() -> Any:
    """The module pyarrow.parquet, which only datasets need.

    Returns
    -------
    Any
        the module

    Raises
    ------
    ConversionError
        pyarrow is not installed.
    """
    try:
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise ConversionError(
            "LeRobot datasets need pyarrow, which is not installed: pip install 'pyarrow>=21'"
        ) from None
    return pyarrow.parquet
