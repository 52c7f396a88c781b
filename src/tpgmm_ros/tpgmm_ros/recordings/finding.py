# SPDX-License-Identifier: Apache-2.0
"""Bags in folders, and which of them are parts of one recording."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.edits import SUFFIX, Edits, edits_of_none
from tpgmm_ros.recordings.storage import metadata
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import BagPath, BagReader, BagTopic, itself
from tpgmm_ros.recordings.storage.formats import has_known_format, is_storage_file

FOLLOWS = 3.0
"""A part begins at most this many periods of the movement after the one before has ended."""
PACKED = (".gz", ".tgz", ".bz2", ".xz", ".lz4", ".zip", ".7z", ".tar")
"""How names of files end that may hold bags, but are none."""
_TOLERANCE_NS = 50_000_000
_CONTINUES_M = 0.005


def find_bags(paths: Iterable[str | Path]) -> list[Path]:
    """Bags among some paths.

    Parameters
    ----------
    paths
        each a bag, or a directory with bags directly inside. A directory of files without metadata.yaml holds as many
        bags as files. What is hidden inside a directory, as its name begins with a dot, is passed over.

    Returns
    -------
    list[Path]
        in the order given, those of a directory in order of name

    Raises
    ------
    BagError
        a path does not exist, or is neither.
    """
    bags: dict[Path, Path] = {}
    for path in map(_named, paths):
        if not path.exists():
            raise BagError(path, "does not exist; expected a bag, or a directory of bags")
        if path.is_dir() and not (path / metadata.NAME).exists():
            there = [bag for child in _inside(path) for bag in _bags_of(child)]
            if lost := edits_of_none(path, there):
                raise BagError(
                    path,
                    f"holds {listed(lost)}, which looks like edits and belongs to none of its bags, so that nothing "
                    f"would be cut or left out: edits of the bag demo_03 are demo_03{SUFFIX}, beside it. Rename it, or "
                    "remove it",
                )
            found = [bag for bag in there if not _is_left_out(bag)]
            if there and not found:
                raise BagError(path, f"all of its bags are left out by their edits (NAME{SUFFIX}): keep one at least")
        else:
            found = [path] if path.is_dir() or has_known_format(path) else _bags_of(path)
        if not found:
            raise BagError(path, _why_none(path))
        for bag in found:
            bags.setdefault(itself(bag), bag)
    return list(bags.values())


def _is_left_out(bag: Path) -> bool:
    """Whether its edits leave all of a bag out; edits that cannot be read make a bag bad, which its reader says."""
    try:
        return Edits.of(bag).leave_out
    except BagError:
        return False


def _named(path: str | Path) -> Path:
    """A path that ends with a name: the working folder is a bag as others are, and metadata stand for their folder."""
    path = Path(path)
    path = path.parent if path.name == metadata.NAME and path.is_file() else path
    return path if path.name not in ("", "..") else Path(os.path.abspath(path))


def _inside(folder: Path) -> list[Path]:
    """What is in a folder, in order of name, without what is hidden: trash, and what macOS puts beside files."""
    return sorted(child for child in folder.iterdir() if not child.name.startswith("."))


def _why_none(path: Path) -> str:
    deeper = [child for child in _inside(path) if child.is_dir()] if path.is_dir() else []
    with_bags = [child.name for child in deeper if any(_bags_of(one) for one in _inside(child))]
    if with_bags:
        return (
            f"holds no bag itself, but bags lie in its folders: {listed(with_bags)}. Give those of these folders that "
            "show one task"
        )
    there = _inside(path) if path.is_dir() else []
    for odd, what in (
        ([one.name for one in there if one.is_symlink() and not one.exists()], "links to what is not there"),
        ([one.name for one in there if one.name.endswith(PACKED)], "files that are packed; unpack them first"),
    ):
        if odd:
            return f"contains no bag, but {what}: {listed(odd)}"
    return (
        "is not a bag and contains none; expected a rosbag2 directory (metadata.yaml and .mcap or .db3), a .bag, .mcap "
        "or .db3 file, or a directory of such bags"
    )


def _bags_of(path: Path) -> list[Path]:
    """A file or a folder with metadata is one bag; a folder without them, as many as it has files."""
    if not path.is_dir():
        return [path] if is_storage_file(path) else []
    if (path / metadata.NAME).exists():
        return [path]
    return list(filter(is_storage_file, _inside(path)))


@dataclass(frozen=True, slots=True)
class _Overview:
    """What a bag has, without its messages."""

    path: Path
    first_ns: int
    last_ns: int
    topics: dict[str, str]
    movement: BagTopic

    @classmethod
    def of(cls, path: Path, movement: str | None) -> _Overview | None:
        """None for a bag that cannot be read, or has no such topic: its reader will say why."""
        try:
            with BagReader(path) as reader:
                named = [
                    t for t in reader.topics if movement is None or f"/{t.name}".endswith(f"/{movement.strip('/')}")
                ]
                busiest = max((t for t in named if "Pose" in t.type), key=lambda t: t.count, default=None)
                if busiest is None or not busiest.count:
                    return None
                topics = {topic.name: topic.type for topic in reader.topics}
                return cls(path, reader.first_ns, reader.last_ns, topics, busiest)
        except BagError:
            return None

    def may_follow(self, other: _Overview) -> bool:
        """Whether this begins where the other ends, with the same topics."""
        period = (other.last_ns - other.first_ns) / max(1, other.movement.count - 1)
        same = self.topics.items() <= other.topics.items() or other.topics.items() <= self.topics.items()
        pause = self.first_ns - other.last_ns
        return (
            same
            and (self.movement.name, self.movement.type) == (other.movement.name, other.movement.type)
            and -_TOLERANCE_NS <= pause <= FOLLOWS * period + _TOLERANCE_NS
            and self.first_ns > other.first_ns
            and self.last_ns > other.last_ns
        )

    def positions(self) -> Array | None:
        """Positions (T, 3) of the movement; None where its messages have none, or cannot be read."""
        try:
            with BagReader(self.path) as reader:
                topic = next(topic for topic in reader.topics if topic.name == self.movement.name)
                return np.array([_position(message) for _, _, message in reader.messages([topic])])
        except (BagError, AttributeError):
            return None

    def is_next_of(self, other: _Overview) -> bool:
        """Whether names say so: recording_0 and recording_1 in one folder."""
        mine, its = _number(self.path), _number(other.path)
        return mine is not None and its is not None and (mine[0], mine[1] - 1) == its


def join_parts(paths: Sequence[Path], movement: str | None = None) -> list[Path]:
    """Put parts of one recording together: the same topics, times that follow, and a hand that goes on where it was.

    Recorders split a recording by size or time. Learned as demonstrations of their own, its parts would be movements
    that begin or end in the middle.

    Parameters
    ----------
    paths
        bags
    movement
        relative topic of what moves; the busiest topic of poses where it is None

    Returns
    -------
    list[Path]
        each a bag, or a `BagPath` with the parts that follow
    """
    found = [_Overview.of(path, movement) for path in paths] if len(paths) > 1 else []
    pairs = [
        (_jump(one, other), i, j)
        for i, one in enumerate(found)
        for j, other in enumerate(found)
        if i != j and one is not None and other is not None and other.may_follow(one)
    ]
    after: dict[int, int] = {}
    for _, i, j in sorted(pair for pair in pairs if pair[0] is not None):
        if i not in after and j not in after.values():
            after[i] = j
    joined = []
    for i in range(len(paths)):
        if i not in after.values():
            chain = [i]
            while chain[-1] in after:
                chain.append(after[chain[-1]])
            joined.append(BagPath.joined([paths[k] for k in chain]))
    return joined


def _jump(one: _Overview, other: _Overview) -> tuple[bool, float] | None:
    """How well another bag goes on where one ends: those first that are called so; None where it does not."""
    called_so = other.is_next_of(one)
    before, behind = one.positions(), other.positions()
    if before is None or behind is None:
        return (False, 0.0) if called_so else None
    steps = [np.linalg.norm(np.diff(part, axis=0), axis=1).max(initial=0.0) for part in (before, behind)]
    jump = float(np.linalg.norm(behind[0] - before[-1]))
    return (not called_so, jump) if jump <= FOLLOWS * max(steps) + _CONTINUES_M else None


def _position(message: Any) -> tuple[float, float, float]:
    pose = getattr(message, "pose", message)
    p = getattr(pose, "pose", pose).position
    return p.x, p.y, p.z


def _number(path: Path) -> tuple[str, int] | None:
    """A name without its last number, and that number."""
    name = re.sub(r"(\.(mcap|db3|bag|zst|zstd))+$", "", path.name)
    found = re.fullmatch(r"(.*?)([0-9]+)", name)
    return None if found is None else (f"{path.parent}/{found[1]}", int(found[2]))
