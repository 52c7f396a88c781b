# SPDX-License-Identifier: Apache-2.0
"""What is seen at one moment: the values that scene and panels show. No ROS, no page, and nothing that changes."""

from __future__ import annotations

from dataclasses import dataclass, field

from tpgmm_core.common.types import Array


@dataclass(frozen=True, slots=True)
class FrameView:
    """One task frame.

    Parameters
    ----------
    name
        as in the task file
    state
        "seen", "held" (not seen now, its last pose still counts), "missing", "refused" or "fixed"
    age
        s since it was seen; None where it never was, or where it is fixed
    pose
        (7,) m and unit quaternion; None where it is not known
    why
        why poses are refused, in words
    """

    name: str
    state: str
    age: float | None = None
    pose: Array | None = None
    why: str = ""

    @property
    def words(self) -> str:
        """The state and how old it is, for people."""
        if self.state == "refused":
            return f"refused: {self.why}" if self.why else "refused"
        if self.state == "missing":
            return "missing" if self.age is None else f"missing for {_seconds(self.age)}"
        if self.state == "held":
            return "held" if self.age is None else f"held, seen {_seconds(self.age)} ago"
        return self.state


@dataclass(frozen=True, slots=True)
class ControllerView:
    """What the controller does, and why."""

    state: str
    reason: str


@dataclass(frozen=True, slots=True)
class ReferenceView:
    """Where the hand is to be: mean (7,), and covariance (6, 6) of position and rotation vector, m and rad."""

    pose: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class ComponentView:
    """A Gaussian of the model where things are now.

    Parameters
    ----------
    pose
        (7,) middle and axes of the ellipsoid
    size
        (3,) its diameters, m
    opacity
        how much it takes part now, 0 to 1
    """

    pose: Array
    size: Array
    opacity: float


@dataclass(frozen=True, slots=True)
class NodeView:
    """A node as it says of itself: whether it is well, its words, and its figures by name."""

    well: bool
    words: str
    values: dict[str, str] = field(default_factory=dict)

    @property
    def figures(self) -> str:
        """Rate and time of a step, where it says so."""
        parts = []
        if rate := self.values.get("tick_rate_hz"):
            parts.append(f"{float(rate):.0f} Hz")
        if float(self.values.get("step_p50_ms", 0.0)) > 0.0:
            parts.append(f"step {float(self.values['step_p50_ms']):.2f} ms")
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class GraphView:
    """What the nodes said last.

    Parameters
    ----------
    joints
        (nv,) rad and m; None as long as the robot says nothing
    hand
        (7,) where the hand is; None where not known
    frames
        all frames of the task
    controller
        None as long as no controller says anything
    reference
        None where none came for a while
    components
        of the model that is reproduced
    nodes
        by name
    """

    joints: Array | None = None
    hand: Array | None = None
    frames: tuple[FrameView, ...] = ()
    controller: ControllerView | None = None
    reference: ReferenceView | None = None
    components: tuple[ComponentView, ...] = ()
    nodes: dict[str, NodeView] = field(default_factory=dict)


def _seconds(age: float) -> str:
    return f"{age:.1f} s" if age < 60.0 else f"{age / 60.0:.0f} min"
