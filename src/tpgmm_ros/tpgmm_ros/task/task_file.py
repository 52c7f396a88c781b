# SPDX-License-Identifier: Apache-2.0
"""The task file: what is demonstrated, which frames it is seen from, and how the model is learned.

    name: pick_place
    base_frame: base                         # every pose is expressed in it
    movement: endpoint/left/pose             # PoseStamped topic of what is demonstrated and reproduced
    endpoint: left                           # the end point of the robot that follows it
    frames:
      object: {topic: object/pose}           # observed: PoseStamped
      robot: {pose: [0, 0, 0, 0, 0, 0, 1]}   # fixed; for all kinds of frames see `frames_section`
    recordings: {...}                        # optional: where recordings differ, see `recordings_section`
    tracking: {visible_timeout: 0.25}        # optional, s
    model: {n_components: 10, init: time}    # optional: the retrieval method, arguments of its estimator
    kinematic: {...}                         # optional: frames that move with the robot, see `kinematic_section`
    movements: {...}                         # for `movement` and `endpoint`: several hands, see `movements_section`

Reading a task file executes nothing and needs no ROS.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.settings import configured
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import (
    a_choice,
    a_name,
    a_number,
    a_text,
    a_topic,
    a_truth,
    an_integer,
)
from tpgmm_core.learning.covariance.structure import STRUCTURES
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.observation.tracked import TrackingConfig
from tpgmm_core.retrieval.encodings import ENCODINGS
from tpgmm_core.retrieval.methods import ALL_METHODS
from tpgmm_ros.messages.sources import JointStateSource, PoseStampedSource, Source
from tpgmm_ros.task.frames_section import TaskFrameSpec, read_frames
from tpgmm_ros.task.kinematic_section import KinematicSpec
from tpgmm_ros.task.movements_section import divided_path, movement_of
from tpgmm_ros.task.recordings_section import PoseArraySpec, read_recordings
from tpgmm_ros.task.signals import TypedSignal
from tpgmm_ros.task.source_entries import a_frame_id
from tpgmm_ros.task.state_space import PoseSpace, StateSpace
from tpgmm_ros.task.takes_section import TakesRule, TopicTakes, read_takes


class TaskError(ValueError):
    """A task file that cannot be used; the text names the file, the key, and what was expected."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a task file says, checked.

    Attributes
    ----------
    name
        name of the task.
    base_frame
        frame_id in which all poses are expressed.
    movement
        relative topic of the PoseStamped that is demonstrated and reproduced; recordings may have it elsewhere.
    endpoint
        end point of the robot that follows the movement.
    frames
        observed and fixed task frames by name, in the order of the file.
    derived
        frames that are made of those, or of the hand's pose at the start.
    tracking
        settings of the frame tracker in s; their names and ranges are the tracker's to check.
    model
        `retrieval`, options of what it encodes, arguments of its estimator: what `Recipe.of` takes.
    recordings
        how demonstrations were recorded where each is one PoseArray.
    recorded_movement
        where recordings have the movement, if not as PoseStamped on the topic `movement`.
    takes
        how each recording is cut into several demonstrations; None: each is one.
    space
        what states are: poses of the end point, or configurations where the file has the part `kinematic`.
    """

    name: str
    base_frame: str
    movement: str
    endpoint: str
    frames: dict[str, TaskFrameSpec]
    space: StateSpace
    tracking: dict[str, float] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    recordings: PoseArraySpec | None = None
    recorded_movement: Source | JointStateSource | None = None
    takes: TakesRule | None = None
    derived: DerivedFrames = field(default_factory=DerivedFrames)

    @classmethod
    def load(cls, path: str | Path) -> "Task":
        """Read a task file.

        Parameters
        ----------
        path
            of the file; where it has several movements, with the one that is meant: carry.yaml#left

        Returns
        -------
        Task
            what it says, checked

        Raises
        ------
        TaskError
            the file is missing, is no YAML, or does not describe a task.
        """
        try:
            file, movement = divided_path(path)
            return cls._of(movement_of(Section.load(file, "a task file"), movement))
        except YamlError as error:
            raise TaskError(str(error)) from None

    @classmethod
    def from_text(cls, text: str, source: str = "task", movement: str | None = None) -> "Task":
        """Read a task from YAML text.

        Parameters
        ----------
        text
            the YAML
        source
            what errors call it
        movement
            which one is meant where it has several

        Returns
        -------
        Task
            what it says, checked

        Raises
        ------
        TaskError
            the text is no YAML, or does not describe a task.
        """
        try:
            return cls._of(movement_of(Section.from_text(text, source), movement))
        except YamlError as error:
            raise TaskError(str(error)) from None

    @classmethod
    def _of(cls, top: Section) -> "Task":
        keys = ("name", "base_frame", "movement", "endpoint", "movements", "frames", "kinematic")
        if "urdf" in top.values:
            raise top.error("is a robot file, as it has 'urdf'; expected a task file: a movement and its frames")
        top.refuse_others(*keys, "recordings", "tracking", "model")
        base_frame, movement = top.required("base_frame", a_frame_id), top.required("movement", a_topic)
        frames, derived = read_frames(top.section("frames"), movement, base_frame)
        space: StateSpace = PoseSpace((*frames, *derived.sources))
        if "kinematic" in top.values:
            if derived.sources:
                raise top.error(
                    "has derived frames and 'kinematic'; movements of joints have none: leave one of them out"
                )
            space = KinematicSpec.of(top.section("kinematic"), frames)
        recorded = top.section("recordings", optional=True)
        recordings, recorded_movement = read_recordings(recorded, base_frame)
        if "kinematic" in top.values and recordings is not None:
            raise top.error("has 'recordings' and 'kinematic'; a PoseArray holds no joints: leave one of them out")
        takes = read_takes(recorded.section("takes")) if "takes" in recorded.values else None
        if recordings is not None and isinstance(takes, TopicTakes):
            raise recorded.error("has takes by a topic; a PoseArray has no times at which to cut it: use 'still'")
        return cls(
            name=top.required("name", a_name),
            base_frame=base_frame,
            movement=movement,
            endpoint=top.required("endpoint", a_name),
            frames=frames,
            space=space,
            tracking=_tracking(top.section("tracking", optional=True)),
            model=_model(top.section("model", optional=True), space),
            recordings=recordings,
            recorded_movement=recorded_movement,
            takes=takes,
            derived=derived,
        )

    @property
    def sources(self) -> dict[str, Source]:
        """What the observed frames are observed by, by frame name."""
        return {name: spec.source for name, spec in self.frames.items() if spec.source is not None}

    @property
    def unknown_after(self) -> dict[str, float]:
        """How long observed frames are where they were last seen, s, by frame name, where the file says it."""
        specs = self.frames.values()
        return {spec.name: spec.unknown_after for spec in specs if spec.unknown_after is not None}

    @property
    def with_hand(self) -> tuple[str, ...]:
        """Frames that move with the hand while they are not seen, if they were seen to."""
        return tuple(spec.name for spec in self.frames.values() if spec.with_hand)

    @property
    def grippers(self) -> dict[str, TypedSignal]:
        """What tells whether the hand holds a frame, by frame name, where the file says it."""
        return {name: spec.gripper for name, spec in self.frames.items() if spec.gripper is not None}

    @property
    def topics(self) -> dict[str, str]:
        """Topics of the frames that are observed as PoseStamped, by frame name."""
        return {name: source.topic for name, source in self.sources.items() if isinstance(source, PoseStampedSource)}


def _tracking(section: Section) -> dict[str, float]:
    values = {key: section.required(key, a_number(0.0)) for key in section.values}
    try:
        configured(TrackingConfig, values)
    except ValueError as error:
        raise section.error(str(error)) from error
    return values


def _model(section: Section, space: StateSpace) -> dict[str, Any]:
    readers: dict[str, Callable[[Any], Any]] = {
        "retrieval": _retrieval_method,
        "n_components": an_integer(1),
        "init": a_choice("time", "kmeans", "bins"),
        "reg_covar": a_number(0.0),
        "tol": a_number(0.0),
        "max_iter": an_integer(1),
        "random_state": an_integer(0),
        "regularization": a_choice("add", "prior"),
        "n_init": an_integer(1),
        "covariance": a_choice(*STRUCTURES),
        "n_factors": an_integer(1),
        "n_threads": an_integer(1),
        "max_duration": an_integer(1),
        "prior_strength": a_number(0.0),
        "n_steps": an_integer(3),
        "n_basis": an_integer(2),
        "locality": a_number(0.0),
        "modes": an_integer(0),
        "mode": an_integer(0),
        "exact": a_text,
        "prune": a_number(0.0),
        "own_end": a_truth,
        "time_warping": a_truth,
        **{item.name: a_number() for encoding in ENCODINGS.values() for item in fields(encoding)},
    }
    section.refuse_others(*filter(space.takes, readers))
    values = {key: section.required(key, readers[key]) for key in section.values}
    try:
        space.recipe(values)
    except ValueError as error:
        raise section.error(f"does not fit together: {error}") from error
    return values


def _retrieval_method(value: Any) -> str:
    """The method's present name; files of earlier versions may have an older one."""
    return str(a_choice(*ALL_METHODS)(current_name(value) if isinstance(value, str) else value))
