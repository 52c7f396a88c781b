# SPDX-License-Identifier: Apache-2.0
"""What a hand does in a movement, moment by moment, so that it can become a correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_workbench.project.coach import Run
from tpgmm_workbench.session.view import GraphView


@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    """What was so at a time, s: share of the movement, the hand (7,), whether it was led, poses (7,) of frames."""

    time: float
    phase: float
    hand: Array
    is_led: bool
    frames: dict[str, Array]


class WatchedRun:
    """The moments of one movement."""

    def __init__(self) -> None:
        self._moments: list[_Moment] = []

    def take(self, now: float, phase: float, graph: GraphView, is_led: bool) -> None:
        """Take in one moment. Where the movement goes back, what comes once more counts in place of what was.

        Parameters
        ----------
        now
            s
        phase
            share of the movement, 0 to 1
        graph
            where hand and frames are; one that is out of sight is where it was seen last
        is_led
            whether somebody leads the hand
        """
        while self._moments and self._moments[-1].phase > phase:
            self._moments.pop()
        if graph.hand is None or (self._moments and self._moments[-1].phase == phase):
            return
        frames = dict(self._moments[-1].frames) if self._moments else {}
        frames |= {frame.name: frame.pose for frame in graph.frames if frame.pose is not None}
        self._moments.append(_Moment(now, phase, np.array(graph.hand), is_led, frames))

    def run(self, feels: bool) -> Run:
        """All of it.

        Parameters
        ----------
        feels
            whether it is known when the hand was led

        Returns
        -------
        Run
            with the frames that were known from the beginning
        """
        moments = self._moments
        names = moments[0].frames if moments else {}
        return Run(
            np.array([moment.time for moment in moments]),
            np.array([moment.hand for moment in moments]).reshape(-1, 7),
            {name: np.array([moment.frames[name] for moment in moments]) for name in names},
            np.array([moment.phase for moment in moments]),
            np.array([moment.is_led for moment in moments], dtype=bool) if feels else None,
        )
