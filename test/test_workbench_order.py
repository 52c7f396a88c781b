# SPDX-License-Identifier: Apache-2.0
"""What is asked for before STOP is asked for before it: nothing that a page has sent overtakes anything."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from benchmarks.page_client import PageClient, open_page
from ros_graph import ROBOT_FILE, TASK_FILE
from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.page.access import Access
from tpgmm_workbench.page.page import Page
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.scene.shapes import read_shapes

pytestmark = pytest.mark.alone
#: How long whatever is heard before STOP takes, s, unless STOP is heard meanwhile.
SLOW = 0.3


class Heard:
    """What the node is asked for. Who asks for anything but STOP is slow, as a thread is that waits for a processor."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._stopped = threading.Event()

    def ask(self, method: Callable[..., object], *_: Any) -> None:
        if method.__name__ != "stop":
            self._stopped.wait(SLOW)
        self.names.append(method.__name__)
        if method.__name__ == "stop":
            self._stopped.set()


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def address(ros_node: Node, tmp_path: Path, heard: Heard) -> Iterator[str]:
    desk = Desk(ros_node, Project.create(tmp_path / "project", TASK_FILE, ROBOT_FILE), simulated=True, seed=3)
    page = Page(desk, heard.ask, read_shapes(desk.robot.urdf, meshes=False), 18380, Access())
    try:
        yield page.address
    finally:
        page.close()
        desk.close()


@pytest.mark.parametrize(
    ("ask", "name"),
    [
        (lambda page: page.press("Run"), "run"),
        (lambda page: page.key("G"), "run"),
        (lambda page: page.press("object", "to object"), "lead_to"),
        (lambda page: page.press("hand", "home"), "lead_to"),
        (lambda page: page.set("speed", 0.5), "set_speed"),
        (lambda page: page.set("hide target", True), "hide_object"),
        (lambda page: page.drag("/gizmos/object", "update"), "move_object"),
    ],
)
@pytest.mark.parametrize("stop", [lambda page: page.press("STOP"), lambda page: page.key("escape")])
def test_stop_is_heard_after_what_was_asked_for_before_it(
    address: str,
    heard: Heard,
    ask: Callable[[PageClient], Awaitable[None]],
    name: str,
    stop: Callable[[PageClient], Awaitable[None]],
) -> None:
    async def use() -> None:
        async with open_page(address) as page:
            await ask(page)
            await stop(page)
            await page.until(lambda: len(heard.names) >= 2, "both to be heard")

    asyncio.run(use())
    assert heard.names[:2] == [name, "stop"]  # a page that drove and is closed lets go


def test_a_drag_of_the_hand_that_is_stopped_leads_it_no_more_until_it_is_taken_hold_of_again(
    address: str, heard: Heard
) -> None:
    async def use() -> None:
        async with open_page(address) as page, open_page(address) as other:
            await page.drag("/gizmos/hand", "start")
            await page.drag("/gizmos/hand", "update", 0.1)
            await page.until(lambda: len(heard.names) == 2, "the hand to be led")
            await other.press("STOP")
            await page.until(lambda: "stop" in heard.names, "the stop")
            await page.drag("/gizmos/hand", "update", 0.2)
            await page.drag("/gizmos/hand", "end")
            await page.press("Run")
            await page.until(lambda: "run" in heard.names, "what is pressed next")
            await page.drag("/gizmos/hand", "start")
            await page.until(lambda: heard.names[-1] == "lead_hand", "the hand to be led again")

    asyncio.run(use())
    assert heard.names[:5] == ["lead_hand", "lead_hand", "stop", "run", "lead_hand"]
