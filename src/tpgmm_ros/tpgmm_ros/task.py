# SPDX-License-Identifier: Apache-2.0
"""The task file: what is demonstrated, which frames it is seen from, and how the model is learned.

    name: pick_place
    base_frame: base                         # every pose is expressed in it
    movement: endpoint/left/pose             # PoseStamped topic of what is demonstrated and reproduced
    endpoint: left                           # the end point of the robot that follows it
    frames:
      object: {topic: object/pose}           # observed
      robot: {pose: [0, 0, 0, 0, 0, 0, 1]}   # fixed: x y z (m), qx qy qz qw, in base_frame
    tracking: {visible_timeout: 0.25}        # optional, s
    model: {n_components: 10, init: time}    # optional: the way of retrieval, arguments of its estimator

Reading a task file executes nothing and needs no ROS.
"""

import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml

from tpgmm_core.learning.structure import STRUCTURES
from tpgmm_core.retrieval.encodings import ENCODINGS
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.ways import WAYS
from tpgmm_core.settings import configured
from tpgmm_core.tracking import TrackingConfig

MANIFOLD = "R1 x R3 x S3"
"""What a task file describes: time, position, orientation. 8 ambient numbers, 7 tangent numbers."""

DIMENSIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Names of the ambient numbers, in their order."""

MAX_BYTES = 64 * 1024

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_QUATERNION_TOLERANCE = 1e-3
"""How far from 1 the norm of a written quaternion may be: three or four digits are what people type."""


class TaskError(ValueError):
    """A task file that cannot be used; the text names the file, the key, and what was expected."""


@dataclass(frozen=True, slots=True)
class TaskFrameSpec:
    """One task frame: observed on a topic, or fixed in the base frame. Exactly one of the two is set.

    Attributes:
        name: name of the frame, as in the model.
        topic: relative topic of its PoseStamped, or None.
        pose: fixed pose (x, y, z in m, qx, qy, qz, qw, unit quaternion) in the base frame, or None.
    """

    name: str
    topic: str | None = None
    pose: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Task:
    """What a task file says, checked.

    Attributes:
        name: name of the task.
        base_frame: frame_id in which all poses are expressed.
        movement: relative topic of the PoseStamped that is demonstrated and reproduced.
        endpoint: end point of the robot that follows the movement.
        frames: task frames by name, in the order of the file.
        tracking: settings of the frame tracker in s; their names and ranges are the tracker's to check.
        model: `retrieval`, options of what it encodes, arguments of its estimator: what `Recipe.of` takes.
    """

    name: str
    base_frame: str
    movement: str
    endpoint: str
    frames: dict[str, TaskFrameSpec]
    tracking: dict[str, float] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> "Task":
        """Read a task file.

        Raises:
            TaskError: the file is missing, is no YAML, or does not describe a task.
        """
        return cls.from_text(_read(Path(path)), source=str(path))

    @classmethod
    def from_text(cls, text: str, source: str = "task") -> "Task":
        """Read a task from YAML text; `source` is what errors call it.

        Raises:
            TaskError: the text is no YAML, or does not describe a task.
        """
        top = _Section(source, "", _parse(text, source))
        top.refuse_others("name", "base_frame", "movement", "endpoint", "frames", "tracking", "model")
        movement = top.required("movement", _topic)
        return cls(
            name=top.required("name", _name),
            base_frame=top.required("base_frame", _frame_id),
            movement=movement,
            endpoint=top.required("endpoint", _name),
            frames=_frames(top.section("frames"), movement),
            tracking=_tracking(top.section("tracking", optional=True)),
            model=_model(top.section("model", optional=True)),
        )

    @property
    def topics(self) -> dict[str, str]:
        """Topics of the observed frames by frame name."""
        return {name: spec.topic for name, spec in self.frames.items() if spec.topic is not None}


def _frames(section: "_Section", movement: str) -> dict[str, TaskFrameSpec]:
    if not section.values:
        raise section.error("is empty: name at least one frame, such as 'object: {topic: object/pose}'")
    taken = {movement: "the movement"}
    frames: dict[str, TaskFrameSpec] = {}
    for name in section.values:
        if not _NAME.fullmatch(name):
            raise section.error(f"has the frame name {name!r}: use letters, digits and underscores")
        entry = section.section(name)
        entry.refuse_others("topic", "pose")
        if len(entry.values) != 1:
            raise entry.error("needs either 'topic' (observed) or 'pose' (fixed), and not both")
        if "pose" in entry.values:
            frames[name] = TaskFrameSpec(name, pose=entry.required("pose", _pose))
            continue
        topic = entry.required("topic", _topic)
        if topic in taken:
            raise entry.error(
                f"has the topic {topic!r}, which is already that of {taken[topic]}: each frame has a topic of its own"
            )
        taken[topic] = f"the frame {name!r}"
        frames[name] = TaskFrameSpec(name, topic=topic)
    return frames


def _tracking(section: "_Section") -> dict[str, float]:
    values = {key: section.required(key, _number(0.0)) for key in section.values}
    try:
        configured(TrackingConfig, values)
    except ValueError as error:
        raise section.error(str(error)) from error
    return values


def _model(section: "_Section") -> dict[str, Any]:
    readers: dict[str, Callable[[Any], Any]] = {
        "retrieval": _choice(*WAYS),
        "n_components": _integer(1),
        "init": _choice("time", "kmeans", "bins"),
        "reg_covar": _number(0.0),
        "tol": _number(0.0),
        "max_iter": _integer(1),
        "random_state": _integer(0),
        "regularization": _choice("add", "prior"),
        "n_init": _integer(1),
        "covariance": _choice(*STRUCTURES),
        "n_factors": _integer(1),
        "max_duration": _integer(1),
        **{item.name: _number() for encoding in ENCODINGS.values() for item in fields(encoding)},
    }
    section.refuse_others(*readers)
    values = {key: section.required(key, readers[key]) for key in section.values}
    try:
        Recipe.of(values)
    except ValueError as error:
        raise section.error(f"does not fit together: {error}") from error
    return values


class _Section:
    """One mapping of the file, and where it stands there, so that errors can say so."""

    def __init__(self, source: str, where: str, values: Any) -> None:
        self.source, self.where = source, where
        if not isinstance(values, Mapping):
            raise self.error(f"is {_shown(values)}, expected a mapping of keys to values")
        for key in values:
            if not isinstance(key, str):
                raise self.error(
                    f"has the key {_shown(key)}, expected a word "
                    "(YAML reads bare on, off, yes, no and numbers as other things: quote them)"
                )
        self.values: Mapping[str, Any] = values

    def error(self, text: str) -> TaskError:
        return TaskError(f"{self.source}: {f"'{self.where}'" if self.where else 'the file'} {text}")

    def path(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def refuse_others(self, *known: str) -> None:
        for key in self.values:
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"; did you mean {close[0]!r}?" if close else ""
                raise self.error(f"has the unknown key {_shown(key)}, expected {', '.join(known)}{hint}")

    def required(self, key: str, read: Callable[[Any], Any]) -> Any:
        if key not in self.values:
            raise self.error(f"lacks the key '{key}'")
        try:
            return read(self.values[key])
        except ValueError as error:
            found = _shown(self.values[key])
            raise TaskError(f"{self.source}: '{self.path(key)}' is {found}, expected {error}") from None

    def section(self, key: str, optional: bool = False) -> "_Section":
        if key not in self.values and not optional:
            raise self.error(f"lacks the key '{key}'")
        return _Section(self.source, self.path(key), self.values.get(key, {}))


# Readers turn one YAML value into what the task holds, or raise ValueError(what was expected).


def _name(value: Any) -> str:
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise ValueError("a name of letters, digits and underscores")
    return value


def _frame_id(value: Any) -> str:
    if not isinstance(value, str) or not value or value.startswith("/") or value.split() != [value]:
        raise ValueError("the frame_id of the poses, without a leading slash")
    return value


def _topic(value: Any) -> str:
    if not isinstance(value, str) or not _TOPIC.fullmatch(value):
        raise ValueError("a relative topic such as object/pose (no leading slash, so that namespaces work)")
    return value


def _pose(value: Any) -> tuple[float, ...]:
    what = "seven finite numbers: x y z (m) qx qy qz qw, with a quaternion of norm 1"
    if not isinstance(value, list) or len(value) != 7:
        raise ValueError(what)
    try:
        pose = [_number()(number) for number in value]
    except ValueError:
        raise ValueError(what) from None
    norm = math.hypot(*pose[3:])
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        raise ValueError(what)
    return (*pose[:3], *(number / norm for number in pose[3:]))


def _number(least: float = -math.inf) -> Callable[[Any], float]:
    def read(value: Any) -> float:
        what = "a finite number" + (f" of at least {least:g}" if math.isfinite(least) else "")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(what)
        try:
            number = float(value)
        except OverflowError:
            raise ValueError(what) from None
        if not math.isfinite(number) or number < least:
            raise ValueError(what)
        return number

    return read


def _integer(least: int) -> Callable[[Any], int]:
    def read(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**32:
            raise ValueError(f"a whole number of at least {least}")
        return value

    return read


def _choice(*choices: str) -> Callable[[Any], str]:
    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            raise ValueError("one of " + ", ".join(choices))
        return value

    return read


def _shown(value: Any, limit: int = 60) -> str:
    """A value as text, short enough for an error."""
    try:
        text = repr(value)
    except ValueError:  # integers beyond Python's limit of digits have no text
        text = f"a {type(value).__name__} too large to show"
    return text if len(text) <= limit else text[:limit] + "…"


class _Loader(yaml.SafeLoader):
    """Safe YAML without aliases (a small file can unfold to gigabytes) and without doubled keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.MarkedYAMLError(problem="aliases (*name) are not allowed here", problem_mark=mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = key_node.value
            if isinstance(key, str) and key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"the key {_shown(key)} stands here twice", problem_mark=key_node.start_mark
                )
            if isinstance(key, str):
                seen.add(key)
        return super().construct_mapping(node, deep)


# YAML 1.1 reads 1e-6 as text, since it has no point; YAML 1.2 and people read a number.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise TaskError(f"{path}: cannot be read ({error.strerror}); expected a task file in YAML") from None
    if len(content) > MAX_BYTES:
        raise TaskError(f"{path}: is larger than {MAX_BYTES} bytes; expected a task file, a page of YAML")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        raise TaskError(f"{path}: is not UTF-8 text; expected a task file in YAML") from None


def _parse(text: str, source: str) -> Any:
    try:
        return yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise TaskError(f"{source}: is nested too deeply to be a task file") from None
    # PyYAML lets more than YAMLError out of malformed scalars: KeyError, IndexError, AttributeError, …
    except Exception as error:
        raise TaskError(f"{source}: is not a YAML file that can be read: {error}") from None
