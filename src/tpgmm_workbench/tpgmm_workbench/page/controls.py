# SPDX-License-Identifier: Apache-2.0
"""Buttons and texts of a page that send nothing as long as nothing has changed, and keys that do what buttons do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from viser import ClientHandle, ViserServer

from tpgmm_workbench.page.names import names_alone
from tpgmm_workbench.scene.heard import in_order

type Ask = Callable[..., None]
"""Called with the number of the page, a method of the desk, and its arguments."""


class Text:
    """HTML in a panel: of all pages, or of one."""

    def __init__(self, place: ViserServer | ClientHandle, order: float | None = None) -> None:
        self._shown = ""
        self._html = place.gui.add_html("", visible=False, order=order)

    def show(self, content: str) -> None:
        """Show this; nothing where it is empty."""
        if content == self._shown:
            return
        self._shown = content
        self._html.content = names_alone(content)
        self._html.visible = bool(content)


class Button:
    """A button, and a key that does the same.

    Parameters
    ----------
    server
        of the page
    label
        what it says; the key is added
    do
        called with the number of the page that asks
    key
        of the keyboard; None: none
    **options
        of viser's button
    """

    def __init__(
        self,
        server: ViserServer,
        label: str,
        do: Callable[[int | None], object],
        key: Any = None,
        **options: Any,
    ) -> None:
        self._key = "" if key is None else f"  [{'Esc' if key == 'escape' else str(key).title()}]"
        self._button = server.gui.add_button(label + self._key, **options)

        def asked(event: Any) -> None:
            do(event.client_id)

        self._button.on_click(in_order(asked))
        self._command = None
        if key is not None:
            self._command = server.gui.add_command(label, hotkey=key)
            self._command.on_trigger(in_order(asked))

    def show(self, reason: str = "", label: str | None = None, is_there: bool = True) -> None:
        """Show whether it may be pressed: not where there is a reason; another label; or nothing of it."""
        if self._button.visible != is_there:
            self._button.visible = is_there
        if self._button.disabled != bool(reason):
            self._button.disabled = bool(reason)
        hint = names_alone(reason) or None
        if self._button.hint != hint:
            self._button.hint = hint
        if label is not None and self._button.label != label + self._key:
            self._button.label = label + self._key
            if self._command is not None:
                self._command.label = label


class Slider:
    """A slider that shows what is so: where what it was moved to was not obeyed, it goes back.

    Parameters
    ----------
    server
        of the page
    label
        what it says
    do
        called with the number of the page that moved it, and the value
    limits
        lowest and highest value; the highest grows where it is asked to show a higher one
    step, value
        between two values; the first value
    **options
        of viser's slider
    """

    def __init__(
        self,
        server: ViserServer,
        label: str,
        do: Callable[[int | None, float], object],
        limits: tuple[float, float],
        step: float,
        value: float,
        **options: Any,
    ) -> None:
        self._slider: Any = server.gui.add_slider(label, *limits, step, value, **options)
        self._seen: float | None = None

        def moved(event: Any) -> None:
            if event.client_id is not None:  # none: this program has set it
                do(event.client_id, float(event.target.value))

        self._slider.on_update(in_order(moved))

    def show(self, value: float) -> None:
        """Show a value, unless the slider was moved since the last time: that is being asked for."""
        is_at_rest = self._slider.value == self._seen
        if self._slider.value != value and is_at_rest:
            if value > self._slider.max:
                self._slider.max = value
            self._slider.value = value
        self._seen = self._slider.value
