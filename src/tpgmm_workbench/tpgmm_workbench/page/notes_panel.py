# SPDX-License-Identifier: Apache-2.0
"""What is noted about one demonstration: a comment, the part that is used, and whether a model learns from it."""

from __future__ import annotations

from typing import Any

from viser import GuiEvent, ViserServer

from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.desk.teaching import TaughtView
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page.controls import Ask, Button
from tpgmm_workbench.scene.heard import in_order

#: What the list of demonstrations holds while there is none.
NONE = "none yet"
#: Steps of the slider of begin and end, s.
STEP = 0.1


class NotesPanel:
    """Boxes that are filled with the notes of a demonstration, and a button that keeps what the user made of them."""

    def __init__(self, server: ViserServer, desk: Desk, ask: Ask) -> None:
        self._desk, self._ask = desk, ask
        self._taught: dict[int, TaughtView] = {}
        self._filled: TaughtView | None = None
        self._newest = 0
        self._is_chosen = False
        with server.gui.add_folder("Notes of one demonstration", expand_by_default=False):
            self._which: Any = server.gui.add_dropdown("which", (NONE,))
            self._comment: Any = server.gui.add_text("comment", "")
            self._part: Any = server.gui.add_multi_slider(
                "part, s", 0.0, 1.0, STEP, (0.0, 1.0), hint="Begin and end of what is used of it"
            )
            self._is_used: Any = server.gui.add_checkbox("learn from it", True)
            for box in (self._which, self._comment, self._part, self._is_used):
                box.on_update(in_order(self._choose))
            self._keep = Button(server, "Keep these notes", self._note)

    def _choose(self, event: GuiEvent[Any]) -> None:
        if event.client_id is not None:  # none: this program has filled the box
            self._is_chosen = True

    def _note(self, page: int | None) -> None:
        if self._filled is not None:
            self._is_chosen = False
            begin, end = (float(value) for value in self._part.value)
            comment, is_used = str(self._comment.value), bool(self._is_used.value)
            self._ask(page, self._desk.teaching.note, self._filled.number, comment, (begin, end), is_used)

    def show(self, view: DeskView) -> None:
        """Show what is noted of the newest, or of the one that a user has chosen.

        What a user is about to change stays until it is kept, or another one is chosen.
        """
        self._taught = {one.number: one for one in view.taught}
        options = tuple(str(number) for number in reversed(self._taught)) or (NONE,)
        if tuple(self._which.options) != options:
            self._which.options = options
            newest = max(self._taught, default=0)
            if newest > self._newest and not self._is_chosen:
                self._which.value = str(newest)
            self._newest = newest
        self._keep.show("" if self._taught else "show a demonstration first")
        chosen = self._taught.get(int(self._which.value)) if self._which.value != NONE else None
        if chosen is not None and _notes(chosen) != _notes(self._filled):
            self._fill(chosen)

    def _fill(self, one: TaughtView) -> None:
        self._filled = one
        self._comment.value = one.comment
        length = max(STEP, one.length)
        self._part.max = length
        self._part.value = (max(0.0, one.part[0]), min(length, one.part[1]))
        self._is_used.value = one.is_used


def _notes(one: TaughtView | None) -> tuple[object, ...]:
    return () if one is None else (one.number, one.comment, one.length, one.part, one.is_used)
