# SPDX-License-Identifier: Apache-2.0
"""Skills of model files, as programs and nodes are told of them."""

from __future__ import annotations

from collections.abc import Sequence

from tpgmm_core.common.text import listed, shown
from tpgmm_core.recognition.skill import Skill
from tpgmm_ros.models.task_model import load_task_model
from tpgmm_ros.task.task_file import Task


def load_skills(named: Sequence[str], task: Task) -> list[Skill]:
    """Skills of one task's frames.

    Parameters
    ----------
    named
        `NAME=FILE`, or `NAME=FILE=PRIOR`: how probable the skill is, against the others, before anything was seen
    task
        whose frames the models know

    Returns
    -------
    list[Skill]
        in this order

    Raises
    ------
    ValueError
        for a text that names no file, a model that does not fit the task, and one of frames that begin with the hand
    OSError
        a file cannot be read
    """
    skills = []
    for text in named:
        name, file, prior = [*text.split("="), "1.0"][:3] if text.count("=") in (1, 2) else ("", "", "")
        try:
            weight = float(prior)
        except ValueError:
            weight = -1.0
        if not (name and file and weight > 0.0):
            raise ValueError(f"a skill is NAME=FILE, or NAME=FILE=PRIOR with a number above 0; got {shown(text)}")
        model = load_task_model(file, task)
        derived = [frame for frame in model.frame_names_ if frame not in task.frames]
        if derived:
            raise ValueError(
                f"the model of {shown(name)} has the frames {listed(derived)}, which are made when a movement of the "
                f"robot begins; to be recognised, a skill has frames of the task file alone: {listed(task.frames)}"
            )
        skills.append(Skill.of_model(name, model, weight))
    return skills
