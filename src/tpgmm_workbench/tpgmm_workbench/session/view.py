# SPDX-License-Identifier: Apache-2.0
"""What is seen at one moment: the values that scene and panels show. No ROS, no page, and nothing that changes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.observation.external_torques import MeasuredForce


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
class TorqueView:
    """The torque that was sent to a joint, and the largest one that it may have, in its unit: "N m", or "N"."""

    joint: str
    torque: float
    limit: float
    unit: str = "N m"

    @property
    def share(self) -> float:
        """How much of the limit is used, 0 to 1 and more."""
        return abs(self.torque) / self.limit if self.limit > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class StiffnessView:
    """How stiff the hand is held: (6, 6) force per deviation, of x, y, z and the rotation vector, N/m and N m/rad."""

    matrix: Array

    @property
    def along(self) -> tuple[Array, Array]:
        """Principal stiffness of positions (3,), N/m, smallest first, and its directions: columns of (3, 3)."""
        return _principal(self.matrix[:3, :3])

    @property
    def about(self) -> tuple[Array, Array]:
        """Principal stiffness of turns (3,), N m/rad, smallest first, and its axes: columns of (3, 3)."""
        return _principal(self.matrix[3:, 3:])


@dataclass(frozen=True, slots=True)
class ReferenceView:
    """Where the hand is to be: mean (7,), and covariance (6, 6) of position and rotation vector, m and rad."""

    pose: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class HorizonView:
    """Where the hand is to be from now on: positions (N, 3), m, and their covariances (N, 3, 3), m^2."""

    path: Array
    covariances: Array


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
        """Rate and times of steps, and how long a step may take, where it says so."""
        parts = []
        if (rate := self._number("tick_rate_hz")) > 0.0:
            parts.append(f"{rate:.0f} Hz")
        if (step := self._number("step_p50_ms")) > 0.0:
            room = f" of {1e3 / rate:.1f} ms" if rate > 0.0 else ""
            slow, longest = self._number("step_p99_ms"), self._number("step_max_ms")
            parts.append(f"step {step:.2f} ms, 1 of 100 over {slow:.2f} ms, longest {longest:.2f} ms{room}")
        return ", ".join(parts)

    def _number(self, key: str) -> float:
        """A figure; 0 where there is none."""
        try:
            value = float(self.values.get(key, ""))
        except ValueError:
            return 0.0
        return value if np.isfinite(value) else 0.0


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
    horizon
        of the reference; None where none came for a while
    components
        of the model that is reproduced
    torques
        sent to the joints; empty where no controller says so
    stiffness
        of the hand; None while nothing is tracked
    force
        on the hand; None where nobody asks for it
    nodes
        by name
    """

    joints: Array | None = None
    hand: Array | None = None
    frames: tuple[FrameView, ...] = ()
    controller: ControllerView | None = None
    reference: ReferenceView | None = None
    horizon: HorizonView | None = None
    components: tuple[ComponentView, ...] = ()
    torques: tuple[TorqueView, ...] = ()
    stiffness: StiffnessView | None = None
    force: MeasuredForce | None = None
    nodes: dict[str, NodeView] = field(default_factory=dict)


def _principal(block: Array) -> tuple[Array, Array]:
    values, vectors = np.linalg.eigh(0.5 * (block + block.T))
    return np.maximum(values, 0.0), vectors


def _seconds(age: float) -> str:
    return f"{age:.1f} s" if age < 60.0 else f"{age / 60.0:.0f} min"
