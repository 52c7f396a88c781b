# SPDX-License-Identifier: Apache-2.0
"""The part `kinematic` of a task file: frames that move with the robot, named next to the frames of objects.

    kinematic:
      robot: baxter.yaml                     # robot file, from this file
      joints: [left_arm, right_arm]          # groups or joints: the configuration, in this order
      joint_states: joint_states             # optional: JointState topic
      tasks:                                 # what of which point matters, and from where it is seen
        bar: {point: right, part: pose, relative_to: left}              # another point of the robot
        left: {point: left, relative_to: left_target, aim: object}      # a frame of the task
        right: {point: right, relative_to: right_target, aim: object}
      hierarchies:                           # candidates: levels, most important first
        left before right: [bar, left, right]
        right before left: [bar, right, left]
        together: [bar, [left, right]]
      postures: [[], [bar, left, right]]     # optional: of all joints, of what these tasks leave free
      threshold: 0.05                        # optional: of the damping near singularities

The model is then over configurations, and its frames are those of `tpgmm_core.kinematics`.
"""

from __future__ import annotations

import functools
import inspect
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from tpgmm_core import TPGMM, LearnedMixture
from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number, a_topic
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.kinematics.frames import JointSpace, KinematicFrame, NullSpace, PreviousConfiguration
from tpgmm_core.kinematics.hierarchy import Level, hierarchy_frames, level_names
from tpgmm_core.kinematics.inverse import THRESHOLD
from tpgmm_core.kinematics.method import NAME, KinematicEncoding, KinematicMethod
from tpgmm_core.kinematics.moving import MovingFrames
from tpgmm_core.kinematics.tasks import KinematicTask
from tpgmm_core.kinematics.urdf import UrdfKinematics
from tpgmm_core.retrieval.encodings import Encoding
from tpgmm_core.retrieval.methods import RetrievalMethod
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.task.kinematic_entries import (
    joint_groups,
    read_hierarchies,
    read_postures,
    read_tasks,
)
from tpgmm_ros.task.state_space import DIMENSIONS, MANIFOLD

PREVIOUS = "previous"
"""Name of the frame about the step before, which every such model has: it damps the steps."""


@dataclass(frozen=True, slots=True)
class KinematicSpec:
    """What the section says, checked as far as that goes without the robot: states are configurations (`StateSpace`).

    Attributes
    ----------
    robot
        the robot file.
    joint_groups
        groups of the robot file, or joints by name, in the order of the configuration.
    joint_states
        relative topic of the JointState.
    objects
        names of the task's frames.
    tasks
        name → task.
    aims
        names of the tasks that aim at the objects that they are relative to, whatever was demonstrated.
    hierarchies
        name → levels, most important first, each a task or several of equal rank.
    postures
        for each posture the tasks that it is below; none for the posture of all joints.
    threshold
        of the damping, m/rad and rad/rad.
    """

    robot: Path
    joint_groups: tuple[str, ...]
    joint_states: str
    objects: frozenset[str]
    tasks: dict[str, KinematicTask]
    aims: frozenset[str]
    hierarchies: dict[str, tuple[Level, ...]]
    postures: tuple[tuple[str, ...], ...] = ()
    threshold: float = THRESHOLD

    @classmethod
    def of(cls, section: Section, objects: Collection[str]) -> KinematicSpec:
        """Read the section of a task file.

        Parameters
        ----------
        section
            of the file
        objects
            the frames of the task

        Returns
        -------
        KinematicSpec
            what it says, checked

        Raises
        ------
        YamlError
            anything that does not describe kinematic frames.
        """
        section.refuse_others("robot", "joints", "joint_states", "tasks", "hierarchies", "postures", "threshold")
        tasks, aims = read_tasks(section.section("tasks"), objects)
        return cls(
            robot=section.path_in("robot", "a robot file"),
            joint_groups=section.required("joints", joint_groups),
            joint_states=section.required("joint_states", a_topic)
            if "joint_states" in section.values
            else "joint_states",
            objects=frozenset(objects),
            tasks=tasks,
            aims=aims,
            hierarchies=read_hierarchies(section.section("hierarchies"), tasks),
            postures=read_postures(section, tasks) if "postures" in section.values else (),
            threshold=section.required("threshold", a_number(1e-6)) if "threshold" in section.values else THRESHOLD,
        )

    needs_state: ClassVar[bool] = True

    @property
    def frame_names(self) -> Collection[str]:
        """Those of the candidates."""
        return self.candidates

    @property
    def description(self) -> str:
        """What the frames of a model mean, as text: models are for the tasks that they were learned from."""
        tasks = {
            name: [task.point, task.part, task.relative_to, "object" if name in self.aims else "learned"]
            for name, task in self.tasks.items()
        }
        levels = {name: list(hierarchy) for name, hierarchy in self.hierarchies.items()}
        return json.dumps([self.joint_groups, tasks, levels, self.postures, self.threshold])

    @property
    def candidates(self) -> dict[str, KinematicFrame]:
        """The frames by name: a level as `kinematics.hierarchy` calls it, "posture", "posture below ..."."""
        frames = hierarchy_frames(self.tasks, self.hierarchies)
        for above in self.postures:
            tasks = tuple(self.tasks[name] for name in above)
            frames[level_names([*above, "posture"])[-1]] = NullSpace(tasks) if tasks else JointSpace()
        frames[PREVIOUS] = PreviousConfiguration()
        return frames

    @property
    def aiming(self) -> list[str]:
        """Those of the candidates that aim at their objects, with all of their tasks."""
        names = [PREVIOUS]
        for hierarchy in self.hierarchies.values():
            for level, name in zip(hierarchy, level_names(hierarchy), strict=True):
                if name not in names and self.aims.issuperset([level] if isinstance(level, str) else level):
                    names.append(name)
        return names

    def joints(self) -> tuple[str, ...]:
        """See `StateSpace`."""
        return self._kinematics().joint_names

    def manifold(self) -> Manifold:
        """See `StateSpace`: time, pose and joint positions."""
        return Manifold.parse(f"{MANIFOLD} x R{len(self.joints())}")

    def dimensions(self) -> tuple[str, ...]:
        """See `StateSpace`."""
        return (*DIMENSIONS, *self.joints())

    def state_dimensions(self) -> tuple[str, ...]:
        """See `StateSpace`: the joints."""
        return self.joints()

    def of_pose(self, pose: Array) -> Array | None:
        """See `StateSpace`: a pose says nothing of the joints."""
        return None

    def of_joints(self, positions: Array) -> Array | None:
        """See `StateSpace`."""
        return positions

    def takes(self, setting: str) -> bool:
        """See `StateSpace`."""
        # one method leads from such models to movements, and it needs the covariances as they are
        return setting in inspect.signature(TPGMM).parameters and setting != "covariance"

    def recipe(self, settings: Mapping[str, Any], method: str | None = None) -> Recipe:
        """With one component (the default) the model is about moments; with more it is over time."""
        arguments = {"n_components": 1, **settings}
        return Recipe(self.method(method), self._encoding(arguments["n_components"] > 1), arguments)

    def encoding_of(self, model: LearnedMixture) -> Encoding:
        """See `StateSpace`. Raises ValueError for a model of other kinematic frames."""
        self.method(None).check(model)
        return self._encoding((model.dimensions_ or ("",))[0] == "time")

    def method(self, name: str | None) -> RetrievalMethod:
        """See `StateSpace.method`.

        Parameters
        ----------
        name
            as the task file has it; None where it has none

        Returns
        -------
        RetrievalMethod
            the one method of kinematic frames

        Raises
        ------
        ValueError
            for any other method
        """
        if name not in (None, NAME):
            raise ValueError(
                f"a model of kinematic frames is reproduced by one method, {NAME}; got {shown(name)}: leave retrieval "
                "empty"
            )
        return KinematicMethod.of(self.frames, self.description)

    def _encoding(self, over_time: bool) -> KinematicEncoding:
        return KinematicEncoding(frames=self.frames, text=self.description, aims=self.aiming, over_time=over_time)

    def frames(self) -> MovingFrames:
        """The candidates on the robot, for one user.

        Returns
        -------
        MovingFrames
            the frames

        Raises
        ------
        ValueError
            the robot file is none, or the robot has no such joints or points.
        OSError
            it cannot be read.
        """
        return MovingFrames(self._kinematics(), self.candidates, self.threshold)

    def _kinematics(self) -> UrdfKinematics:
        robot = _robot(self.robot)
        observers = {task.relative_to for task in self.tasks.values() if task.relative_to is not None}
        unclear = [name for name in observers if (name in self.objects) == (name in robot.endpoints)]
        if unclear:
            raise ValueError(
                f"tasks are relative to {listed(sorted(unclear))}; expected either a frame of the task "
                f"({', '.join(sorted(self.objects))}) or another end point of the robot ({', '.join(robot.endpoints)})"
            )
        points = {task.point for task in self.tasks.values()} | (observers - self.objects)
        return UrdfKinematics(robot, self.joint_groups, sorted(points))


@functools.lru_cache(maxsize=4)
def _robot(path: Path) -> RobotModel:
    return RobotModel.from_file(path)
