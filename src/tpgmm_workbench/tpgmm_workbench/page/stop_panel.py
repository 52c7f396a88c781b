# SPDX-License-Identifier: Apache-2.0
"""STOP, with what goes on and what to do next: a panel of its own that nothing scrolls away and nothing lies over."""

from __future__ import annotations

from collections.abc import Callable

from viser import Icon, ViserServer

from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page import words
from tpgmm_workbench.page.controls import Button, Text
from tpgmm_workbench.project.activities import Activity

#: Gap to the left and to the lower edge of the page, and width, in pixels of CSS.
GAP, WIDTH = 15, 340


class StopPanel:
    """A floating panel at the lower left.

    Parameters
    ----------
    server
        of the page
    stop
        called when any page presses STOP, or Esc
    """

    def __init__(self, server: ViserServer, stop: Callable[[], object]) -> None:
        self._panel = server.gui.add_panel()
        with self._panel.add_tab("Now"):
            Button(server, "STOP", lambda _: stop(), "escape", color="red", icon=Icon.HAND_STOP)
            self._status = Text(server)
        self._panel.float(x=GAP, y=-GAP, width=WIDTH)
        self._activity = Activity.IDLE

    def show(self, view: DeskView) -> None:
        """Show what goes on; where a user has folded the panel, it opens when the robot begins to move."""
        self._status.show(words.status(view))
        if view.activity is not self._activity:
            self._activity = view.activity
            if view.activity is not Activity.IDLE:
                self._panel.expand()
