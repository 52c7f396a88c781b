# SPDX-License-Identifier: Apache-2.0
"""From a lesson to a bag to a model: one Gaussian in each candidate frame, from one demonstration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.geometry.manifold import POSE
from tpgmm_demos.figure5.contacts import lesson_contacts, to_start
from tpgmm_demos.figure5.lessons import HANDS, LESSON_TIME, LESSONS
from tpgmm_demos.figure5.session import TOUCH_RATE, Session
from tpgmm_ros.messages.sources import PoseStampedSource
from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.recordings.bags import read_recording
from tpgmm_ros.recordings.recorded_topics import JOINT_STATE
from tpgmm_ros.task.task_file import Task

#: Of the recorded poses, and of the joint states, one in so many is kept.
KEEP_EVERY = {"poses": round(TOUCH_RATE / 100.0), "joint_states": 20}
#: Added to variances, m² and rad²: nobody holds anything more surely than to some tenths of a millimetre.
REG_COVAR = 1e-7


def record_lesson(session: Session, task: Task, bag: Path, random: np.random.Generator) -> None:
    """Lead both hands through the lesson of a task, and record what is on the topics.

    Raises
    ------
    FileExistsError
        where there is a bag already
    """
    to_start(session)
    poses = [f"endpoint/{hand}/pose" for hand in HANDS]
    topics = {**dict.fromkeys(poses, PoseStampedSource.message_type), "joint_states": JOINT_STATE}
    keep = {**dict.fromkeys(poses, KEEP_EVERY["poses"]), "joint_states": KEEP_EVERY["joint_states"]}
    contacts = lesson_contacts(session, LESSONS[task.name](random))
    with BagRecorder(session.graph.node, topics, keep, drop_repeated=True).into(bag):
        session.run(LESSON_TIME, contacts)


def learn(task: Task, bag: Path) -> TPGMM:
    """One Gaussian of the hand's pose in each frame of the task.

    Parameters
    ----------
    task
        of the task file
    bag
        with the demonstration

    Returns
    -------
    TPGMM
        a fitted model

    Raises
    ------
    BagError
        for a bag that does not hold it
    """
    recording = read_recording(bag, task)
    frames = {name: Frame.from_pose(poses[:, :3], poses[:, 3:]) for name, poses in recording.frames.items()}
    demonstration = Demonstration(recording.times, recording.movement, frames, recording.visible)
    # the start does not matter: a single Gaussian is found at once
    model = TPGMM(n_components=1, manifold=str(POSE), init="kmeans", reg_covar=REG_COVAR)
    return model.fit([demonstration])
