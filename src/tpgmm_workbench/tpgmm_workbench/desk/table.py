# SPDX-License-Identifier: Apache-2.0
"""A simulation's table: the hand is led, and objects are laid elsewhere or hidden. A real robot has none of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from rclpy.node import Node

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_workbench.graph.movement import MovementClient
from tpgmm_workbench.graph.simulated_world import SimulatedWorld
from tpgmm_workbench.project.activities import Action
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.session.arrangement import Arrangement, hand_over, regions_of
from tpgmm_workbench.session.view import GraphView


def simulated_world(node: Node, project: Project, robot: RobotModel, home: Array, seed: int | None) -> SimulatedWorld:
    """A hand that is led, and objects to be moved.

    Parameters
    ----------
    node
        publishes
    project, robot
        of the task
    home
        (7,) the hand's pose at the robot's home
    seed
        of the objects' places; None: others each time

    Returns
    -------
    SimulatedWorld
        of the task
    """
    task = project.task
    regions = regions_of(task.name, task.topics, home)
    return SimulatedWorld(node, task, Arrangement(regions, seed), robot.endpoints[task.endpoint].frame)


class SimulatedTable:
    """What only a simulation lets a user do.

    Parameters
    ----------
    world
        hand and objects; None beside a real robot, where nothing of this happens
    home
        (7,) the hand's pose at the robot's home
    movement
        lets go of the arm before it is led
    refused
        whether something may not be done now; it tells the user why
    say
        gets what is to be known, in words
    """

    def __init__(
        self,
        world: SimulatedWorld | None,
        home: Array,
        movement: MovementClient,
        refused: Callable[[Action], bool],
        say: Callable[[str], object],
    ) -> None:
        self._world, self._home, self._movement = world, home, movement
        self._refused, self._say = refused, say
        self._graph = GraphView()

    @property
    def places(self) -> dict[str, Array]:
        """Where the objects are, (7,) by name."""
        return {} if self._world is None else dict(self._world.arrangement.places)

    @property
    def hidden(self) -> frozenset[str]:
        """Those of them that nobody sees."""
        return frozenset() if self._world is None else frozenset(self._world.arrangement.hidden)

    @property
    def aim(self) -> Array | None:
        """To where the hand is led, (7,); None while nobody leads it."""
        return None if self._world is None else self._world.aim

    @property
    def to_go(self) -> float | None:
        """How far the hand still is from there, m."""
        if self.aim is None or self._graph.hand is None:
            return None
        return pose_error(self._graph.hand, self.aim)[0]

    def watch(self, graph: GraphView) -> None:
        """Take in what the nodes said last."""
        self._graph = graph

    def lead_hand(self, aim: Array, is_held: bool = False) -> None:
        """Lead the hand.

        Parameters
        ----------
        aim
            (7,) to there
        is_held
            whether the mouse holds it; a hand that is pushed while the skill runs is let go of with the mouse
        """
        if self._world is None or (is_held and self._refused(Action.DRAG_HAND)):
            return
        if self._movement.view.goes_on:
            self._world.aim = np.array(aim) if is_held else None
            return
        controller = self._graph.controller
        if controller is not None and controller.state == "ACTIVE":
            self._movement.let_go()
        self._world.aim = np.array(aim)

    def lead_to(self, name: str, above: bool) -> None:
        """Lead the hand to an object, or above it; "home": to where it is at home."""
        if self._world is None or self._refused(Action.DRAG_HAND):
            return
        if self._movement.view.goes_on:
            self._say("the skill runs: stop it before the hand is led")
            return
        if name == "home":
            self.lead_hand(self._home)
        elif name in self._world.arrangement.places:
            self.lead_hand(hand_over(self._world.arrangement.places[name], self._home, above))

    def let_go(self) -> None:
        """Give the hand no more force."""
        if self._world is not None:
            self._world.aim = None

    def move_object(self, name: str, pose: Array) -> None:
        """Lay an object at a pose (7,)."""
        self.lay({name: pose})

    def lay(self, places: Mapping[str, Array]) -> None:
        """Lay objects at poses (7,), by name; others stay where they are."""
        if self._world is not None:
            for name, pose in places.items():
                if name in self._world.arrangement.places:
                    self._world.arrangement.move(name, pose)

    def hide_object(self, name: str, hidden: bool) -> None:
        """Hide an object from its sensors, or show it again."""
        if self._world is not None:
            self._world.arrangement.hide(name, hidden)

    def shuffle(self) -> None:
        """Lay the objects elsewhere."""
        if self._world is not None:
            self._world.arrangement.shuffle()
