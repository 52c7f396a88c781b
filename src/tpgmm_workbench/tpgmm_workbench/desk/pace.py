# SPDX-License-Identifier: Apache-2.0
"""How fast a skill runs: as the user says, not at all, or as soon as an arm that was let go of is back.

An arm that was held while time went on is far from its reference, and comes back slowly. Would time go on meanwhile,
the arm would cut what is left of the movement, and be judged at its end before it is there.
"""

from __future__ import annotations

import time

import numpy as np

from tpgmm_workbench.graph.movement import MovementClient, RunView
from tpgmm_workbench.session.view import GraphView

#: A hand that is let go of farther from its reference is waited for, until it is so near, m.
FAR, NEAR = 0.05, 0.03
#: An arm that comes no nearer, by so much, m, within so long, s, is not waited for: the controller says why.
NEARER, PATIENCE = 0.005, 4.0


class Pace:
    """See the module.

    Parameters
    ----------
    movement
        that runs

    Attributes
    ----------
    speed
        as the user says; 1: as learned, below 0: back
    is_paused
        whether the user has paused it
    is_waiting
        whether it waits for the arm
    words
        about the waiting; empty where there was none in this run
    """

    def __init__(self, movement: MovementClient) -> None:
        self.speed, self.is_paused, self.is_waiting, self.words = 1.0, False, False, ""
        self._movement = movement
        self._was_led = False
        self._nearest, self._since = np.inf, 0.0

    def set(self, speed: float) -> None:
        """Run at this speed from now on."""
        self.speed, self.is_paused, self.is_waiting = speed, False, False
        self._movement.set_speed(speed)

    def pause(self) -> None:
        """Stand still."""
        self.is_paused, self.is_waiting = True, False
        self._movement.set_speed(0.0)

    def begin(self) -> None:
        """A run begins."""
        self._was_led, self.words = False, ""
        self.set(self.speed)

    def watch(self, run: RunView, graph: GraphView, is_led: bool) -> None:
        """Take in one moment.

        Parameters
        ----------
        run
            how far the movement is
        graph
            where the hand is, and where it is to be
        is_led
            whether somebody corrects the movement now
        """
        is_let_go, self._was_led = self._was_led and not is_led, is_led
        if run.stage != "running" or is_led:
            self._go_on("")
            return
        now, away = time.monotonic(), np.inf
        if graph.reference is not None and graph.hand is not None:
            away = float(np.linalg.norm(graph.hand[:3] - graph.reference.pose[:3]))
        if is_let_go and FAR < away < np.inf and not self.is_paused and self.speed != 0.0:
            self.is_waiting = True
            self._nearest, self._since = away, now
            self._movement.set_speed(0.0)
        if not self.is_waiting:
            return
        if away < self._nearest - NEARER:
            self._nearest, self._since = away, now
        self.words = (
            f"the movement waits until the hand is back where it is to be: {100.0 * self._nearest:.0f} cm to go"
        )
        if away < NEAR:
            self._go_on("")
        elif now - self._since > PATIENCE:
            self._go_on(
                f"the movement goes on although the hand does not come back: {100.0 * self._nearest:.0f} cm are left"
            )

    def _go_on(self, words: str) -> None:
        if self.is_waiting:
            self.is_waiting, self.words = False, words
            self._movement.set_speed(self.speed)
