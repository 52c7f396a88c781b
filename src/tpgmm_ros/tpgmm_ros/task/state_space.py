# SPDX-License-Identifier: Apache-2.0
"""What the states of a task are, poses or configurations of joints: all that differs between the two.

Nodes, recordings and programs ask a task's `space`, and do not ask which of the two it is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from tpgmm_core import LearnedMixture
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.retrieval.encodings import Encoding, encoding_of
from tpgmm_core.retrieval.methods import RetrievalMethod, method_named
from tpgmm_core.retrieval.recipe import Recipe

MANIFOLD = "R1 x R3 x S3"
"""What demonstrations of poses are over: time, position, orientation. 8 ambient numbers, 7 tangent numbers."""

DIMENSIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Names of the ambient numbers, in their order."""


class StateSpace(Protocol):
    """The states of a task, and the models that are about them.

    Attributes
    ----------
    joint_states
        relative topic of the JointState.
    needs_state
        whether a movement can begin only where the state is known.
    frame_names
        what frames of a model may be called.
    """

    @property
    def joint_states(self) -> str:
        """Relative topic of the JointState."""

    @property
    def needs_state(self) -> bool:
        """Whether a movement can begin only where the state is known."""

    @property
    def frame_names(self) -> Collection[str]:
        """What frames of a model may be called."""

    def joints(self) -> tuple[str, ...]:
        """The joints that a state consists of.

        Returns
        -------
        tuple[str, ...]
            in the state's order; none where it is a pose

        Raises
        ------
        ValueError
            the robot has no such joints.
        OSError
            the robot file cannot be read.
        """

    def manifold(self) -> Manifold:
        """Space of demonstrations: [time, pose], and a configuration where there are joints; raises like `joints`."""

    def dimensions(self) -> tuple[str, ...]:
        """Names of the numbers of demonstrations; raises like `joints`."""

    def state_dimensions(self) -> tuple[str, ...]:
        """Names of the numbers of a state; raises like `joints`."""

    def of_pose(self, pose: Array) -> Array | None:
        """The state, where the pose (7,) of the task's end point is one."""

    def of_joints(self, positions: Array) -> Array | None:
        """The state, where positions (n,) of `joints` are one."""

    def takes(self, setting: str) -> bool:
        """Whether a model of these states has this setting."""

    def recipe(self, settings: Mapping[str, Any], method: str | None = None) -> Recipe:
        """How a model is learned.

        Parameters
        ----------
        settings
            of the task file
        method
            in place of theirs

        Returns
        -------
        Recipe
            the recipe

        Raises
        ------
        ValueError
            settings or a method that a model of these states has not.
        """

    def encoding_of(self, model: LearnedMixture) -> Encoding:
        """What a model encodes. Raises ValueError for one that was not learned for this task."""

    def method(self, name: str | None) -> RetrievalMethod | None:
        """The retrieval method by name; None where the model decides. Raises ValueError for one that it has not."""


@dataclass(frozen=True, slots=True)
class PoseSpace:
    """Poses of the task's end point, [x, y, z, qx, qy, qz, qw] in the base frame; see `StateSpace`."""

    frame_names: tuple[str, ...]
    joint_states: str = "joint_states"
    needs_state: bool = False

    def joints(self) -> tuple[str, ...]:
        """None: a state is a pose."""
        return ()

    def manifold(self) -> Manifold:
        """Time and pose."""
        return Manifold.parse(MANIFOLD)

    def dimensions(self) -> tuple[str, ...]:
        """Names of time and pose."""
        return DIMENSIONS

    def state_dimensions(self) -> tuple[str, ...]:
        """Names of the pose."""
        return DIMENSIONS[1:]

    def of_pose(self, pose: Array) -> Array | None:
        """The pose itself."""
        return pose

    def of_joints(self, positions: Array) -> Array | None:
        """None: joints say nothing of the pose."""
        return None

    def takes(self, setting: str) -> bool:
        """All settings."""
        return True

    def recipe(self, settings: Mapping[str, Any], method: str | None = None) -> Recipe:
        """See `StateSpace`."""
        return Recipe.of(settings, method)

    def encoding_of(self, model: LearnedMixture) -> Encoding:
        """What the model's own metadata say."""
        return encoding_of(model)

    def method(self, name: str | None) -> RetrievalMethod | None:
        """See `StateSpace`."""
        return None if name is None else method_named(name)
