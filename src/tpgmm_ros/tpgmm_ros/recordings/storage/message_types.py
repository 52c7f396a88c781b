# SPDX-License-Identifier: Apache-2.0
"""Messages out of bytes, by the definitions of those types alone that are wanted."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tpgmm_core.common.text import one_line, shown
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.pose_bytes import POSE_STAMPED, PoseStampedDecoder, is_standard
from tpgmm_ros.recordings.storage.storage_file import FileTopic

_IDL_SEPARATOR = "=" * 80 + "\n"


def decoder(path: Path, topic: FileTopic) -> Callable[[bytes], Any]:
    """What makes messages of a topic's bytes.

    The definition in the bag is the one that counts. Where there is none, or none that can be parsed, standard types
    are known all the same.

    Parameters
    ----------
    path
        of the bag, for errors
    topic
        whose messages are wanted

    Returns
    -------
    Callable[[bytes], Any]
        bytes → message; raises whatever it meets in bytes that are no such message

    Raises
    ------
    BagError
        the encoding or the type is not known.
    """
    store, name = types_of(path, topic), topic.type
    if topic.encoding == "ros1":
        return lambda raw: store.deserialize_ros1(raw, name)
    return lambda raw: store.deserialize_cdr(raw, name)


def quick_decoder(path: Path, topic: FileTopic) -> Callable[[bytes], Any]:
    """The same, but poses come as `StampedPose` where their bytes are as usual, without a message object.

    Parameters
    ----------
    path, topic
        as for `decoder`

    Returns
    -------
    Callable[[bytes], Any]
        bytes → message or `StampedPose`

    Raises
    ------
    BagError
        as for `decoder`.
    """
    slow = decoder(path, topic)
    if topic.type != POSE_STAMPED or topic.encoding != "cdr" or not is_standard(types_of(path, topic)):
        return slow
    quick = PoseStampedDecoder()

    def decode(raw: bytes) -> Any:
        found = quick(raw)
        return slow(raw) if found is None else found

    return decode


def types_of(path: Path, topic: FileTopic) -> Typestore:
    """What knows the type of a topic: see `decoder`.

    Parameters
    ----------
    path
        of the bag, for errors
    topic
        of a file

    Returns
    -------
    Typestore
        the type, and all that it is made of

    Raises
    ------
    BagError
        the encoding or the type is not known.
    """
    if topic.encoding not in ("cdr", "ros1"):
        raise BagError(
            path,
            f"{one_line(topic.name, 60)} has messages in the encoding {shown(topic.encoding)}, expected cdr (ROS 2) or "
            "ros1; record it from ROS topics, or take another topic",
        )
    try:
        return _own_types(topic.type, topic.definition, topic.definition_format)
    except Exception as error:  # parsers of definitions raise many things
        store = _standard_types(topic.encoding == "ros1")
        if topic.type not in store.fielddefs:
            raise BagError(
                path,
                f"{one_line(topic.name, 60)} is of type {one_line(topic.type, 60)}, whose definition in the bag cannot "
                f"be parsed ({one_line(error, 150)}), and which is no standard type",
            ) from None
        return store


@cache
def _own_types(name: str, definition: bytes, kind: str) -> Typestore:
    if not definition:
        raise ValueError("there is none")
    text = definition.decode()
    if kind in ("ros2msg", "ros1msg"):
        types = dict(get_types_from_msg(text, name))
    elif kind in ("ros2idl", "omgidl"):
        types = {}
        for part in text.split(_IDL_SEPARATOR):
            if part.strip():
                types.update(get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part))
    else:
        raise ValueError(f"it is written in {shown(kind)}")
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    if name not in store.fielddefs:
        raise ValueError("it defines other types")
    return store


@cache
def _standard_types(is_ros1: bool) -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
