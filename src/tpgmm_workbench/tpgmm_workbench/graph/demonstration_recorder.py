# SPDX-License-Identifier: Apache-2.0
"""One demonstration at a time into a bag: begun, and then kept or left unfinished."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.recordings.recorded_topics import topics_of
from tpgmm_ros.task.task_file import Task

#: Joint states come at up to 1 kHz; a demonstration needs no more of them than of poses.
KEEP_EVERY = {"joint_states": 5}


class DemonstrationRecorder:
    """A demonstration that is being recorded; it begins at once.

    Parameters
    ----------
    node
        subscribes
    path
        of the bag, which does not exist yet
    task
        whose topics are recorded

    Raises
    ------
    OSError
        where the bag cannot be written
    """

    def __init__(self, node: Node, path: Path, task: Task) -> None:
        self.path, self._movement = path, task.movement
        self._recorder = BagRecorder(node, topics_of(task), KEEP_EVERY, drop_repeated=True)
        try:
            self._recorder.start(path.parent, path.name)
        except BaseException:
            self._recorder.close()
            raise

    @property
    def poses(self) -> int:
        """How many poses of the movement have come."""
        return int(self._recorder.counts.get(self._movement, 0))

    def keep(self) -> None:
        """End it. The bag is in its place then.

        Raises
        ------
        ValueError
            where the recording broke off before, with the reason
        OSError
            where the disk did not take all of it
        """
        try:
            self._recorder.stop()
        finally:
            self._recorder.close()

    def leave(self) -> None:
        """End it unfinished: what came stays where unfinished bags lie, and never counts."""
        self._recorder.close()
