# SPDX-License-Identifier: Apache-2.0
"""What a recorder wrote before it was killed, or before the disk was full, as a whole bag."""

from __future__ import annotations

from pathlib import Path

from tpgmm_core.common.text import one_line
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import BagReader, unpacked
from tpgmm_ros.recordings.storage.bag_writer import BagWriter
from tpgmm_ros.recordings.storage.message_types import types_of


def recover(path: Path, bag: Path) -> tuple[float, dict[str, int], list[str]]:
    """Write what can be read of a recording that was cut off into a new bag; the original is left as it is.

    Parameters
    ----------
    path
        the recording: a folder or a file
    bag
        the new bag; must not exist yet

    Returns
    -------
    tuple[float, dict[str, int], list[str]]
        duration, s; messages by topic; what was left out, in words

    Raises
    ------
    BagError
        there is no whole message in it, or it is damaged in its midst.
    FileExistsError
        there is something at `bag` already.
    OSError
        it cannot be written.
    """
    left_out = []
    with BagReader(path, whole=False) as reader:
        known = {}
        for topic in reader.topics:
            if topic.sources[0][1].encoding != "cdr":
                left_out.append(f"{one_line(topic.name, 60)}: its messages are not serialised as ROS 2 does (cdr)")
                continue
            try:
                known[topic] = types_of(path, topic.sources[0][1])
            except BagError as error:
                left_out.append(one_line(error.text))
        if not any(topic.count for topic in known):
            raise BagError(path, "holds no whole message: there is nothing to recover; record it again")
        writer = BagWriter(bag)
        try:
            counts = dict.fromkeys((topic.name for topic in known), 0)
            topics = {topic: writer.add_topic(topic.name, topic.type, types) for topic, types in known.items()}
            for topic, at, raw in reader.raw_messages(list(known)):
                writer.write(topics[topic], at, unpacked(raw))
                counts[topic.name] += 1
            writer.close()
        except BaseException:
            writer.discard()
            raise
    return writer.duration_s, counts, left_out
