# SPDX-License-Identifier: Apache-2.0
"""A project as a file: the browser gets it, or gives one of somebody else's; and pictures of the scene."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from viser import ClientHandle, GuiEvent, Icon, ViserServer

from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.desk.sharing import Deliver
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page import words
from tpgmm_workbench.page.controls import Ask, Button, Text
from tpgmm_workbench.page.own_thread import in_own_thread
from tpgmm_workbench.page.picture import draw_of
from tpgmm_workbench.project.activities import Action
from tpgmm_workbench.scene.heard import in_order


class SharePanel:
    """Export, import, pictures.

    Parameters
    ----------
    server
        of the page
    desk
        what the user may ask for
    ask
        for what only the page that drives may do
    give
        for what every page may ask for
    """

    def __init__(self, server: ViserServer, desk: Desk, ask: Ask, give: Callable[..., object]) -> None:
        self._server, self._desk, self._ask, self._give = server, desk, ask, give
        self._export = Button(server, "Export this project", self._send, icon=Icon.DOWNLOAD)
        self._import = server.gui.add_upload_button(
            "Import a project", mime_type="application/zip,.zip", icon=Icon.UPLOAD
        )
        self._import.on_upload(in_order(self._take))
        self._text = Text(server)
        Button(server, "Take a picture", self._shoot, icon=Icon.CAMERA)
        self._pictured = Text(server)

    def _deliver(self, client: ClientHandle) -> Deliver:
        """What lets a browser download a file; from any thread."""
        return lambda name, content: in_own_thread(
            self._server, partial(client.send_file_download, name, content, save_immediately=True)
        )

    def _shoot(self, page: int | None) -> None:
        client = self._server.get_clients().get(page) if page is not None else None
        if client is not None:
            self._give(self._desk.pictures.take, draw_of(client), self._deliver(client))

    def _send(self, page: int | None) -> None:
        client = self._server.get_clients().get(page) if page is not None else None
        if client is not None:
            self._give(self._desk.sharing.give, self._deliver(client))

    def _take(self, event: GuiEvent[Any]) -> None:
        self._ask(event.client_id, self._desk.sharing.take, event.target.value.name, event.target.value.content)

    def show(self, view: DeskView) -> None:
        """Show what is known."""
        self._export.show(view.reasons.get(Action.EXPORT, ""))
        reason = view.reasons.get(Action.IMPORT, "")
        if self._import.disabled != bool(reason):
            self._import.disabled = bool(reason)
        self._text.show(words.sharing(view))
        self._pictured.show(words.picture(view))
