# SPDX-License-Identifier: Apache-2.0
"""What the metadata.yaml of a rosbag2 folder says of its files, as far as it is needed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any

import yaml

from tpgmm_core.common.text import listed, one_line
from tpgmm_ros.recordings.storage.bag_error import BagError

NAME = "metadata.yaml"
_LIMIT = 16 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Metadata:
    """Files of a recording, and how many messages they hold together.

    Attributes
    ----------
    files
        in the order of recording
    counts
        topic → number of messages
    """

    files: tuple[Path, ...]
    counts: Mapping[str, int]

    @classmethod
    def of(cls, folder: Path) -> Metadata:
        """Read the metadata.yaml of a folder; what does not concern files and counts may be wrong or missing.

        Returns
        -------
        Metadata
            what it says

        Raises
        ------
        BagError
            it is no metadata of a bag, or names files that are not there.
        """
        try:
            with (folder / NAME).open("rb") as file:
                content = yaml.load(file.read(_LIMIT), _LOADER)
            about = content["rosbag2_bagfile_information"]
            names = [PurePath(name).name for name in about["relative_file_paths"]]
            counts: Counter[str] = Counter()
            for entry in about.get("topics_with_message_count") or ():
                counts[entry["topic_metadata"]["name"]] += int(entry["message_count"])
        # Of malformed files PyYAML lets more out than its YAMLError, and anything may stand where a list should.
        except Exception as error:
            raise BagError(
                folder,
                f"cannot be read: its {NAME} is damaged ({type(error).__name__}: {one_line(error, 100)}). Run 'ros2 "
                "bag reindex' on the folder; or remove that file, then the others are read as they are",
            ) from None
        if not names:
            raise BagError(
                folder,
                f"cannot be read: its {NAME} names no file, as where the recorder was killed. Remove that file, then "
                "the others are read as they are; or run 'ros2 bag reindex' on the folder",
            )
        files = [_there(folder, name) for name in names]
        missing = [name for name, file in zip(names, files, strict=True) if file is None]
        if missing:
            raise BagError(
                folder,
                f"cannot be read: {listed(missing, 5)} is missing, which {NAME} names as a part of it; copy "
                "the part here, or run 'ros2 bag reindex' to go on without it",
            )
        return cls(tuple(file for file in files if file is not None), counts)


def _there(folder: Path, name: str) -> Path | None:
    """The file, packed or not: metadata do not always say; also where a path of Windows stands for it."""
    names = [
        other
        for one in dict.fromkeys((name, PureWindowsPath(name).name))
        for other in (one, f"{one}.zstd", f"{one}.zst", one.removesuffix(".zstd"), one.removesuffix(".zst"))
    ]
    return next((folder / other for other in names if other and (folder / other).is_file()), None)


_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
