# SPDX-License-Identifier: Apache-2.0
"""Someone at the page of the workbench, in a real browser: sees what is on it, clicks, presses keys and drags."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from ros_graph import ROOT, Inbox
from ros_testing import RunningProcess, spin_until
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.quaternion import rotation_matrix
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_workbench.page.camera import Camera

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
OUTPUT = ROOT / "out" / "workbench_page"
WIDTH, HEIGHT = 1000, 640
WINDOW = {"width": WIDTH, "height": HEIGHT}
PATIENCE = 150.0
#: Length of an object's gizmo, m, and the share of it where its arrow is taken hold of.
GIZMO, HOLD = 0.16, 0.85


@pytest.fixture
def browser() -> Iterator[Any]:
    """A browser without a window; a test that asks for it is skipped where there is none."""
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install --no-install-recommends chromium")
    sync_api = pytest.importorskip("playwright.sync_api", reason="no Playwright: `make dev` installs it")
    with sync_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield running
        running.close()


class User:
    """Someone at the page."""

    def __init__(
        self, browser: Any, node: Node, process: RunningProcess, address: str, window: dict[str, int] = WINDOW
    ) -> None:
        self._node, self.process = node, process
        self.page = browser.new_page(viewport=window)
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.asked: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(address)
        self.is_heard()

    def is_heard(self) -> None:
        """Wait until the page says no more that nothing is heard."""
        self.page.get_by_role("button", name="STOP").first.wait_for()
        self.until(lambda: not self.notice(), "the page to be heard")

    def notice(self) -> str:
        """Why nothing is heard; empty where all is."""
        return str(self.page.locator("#tpgmm-notice").text_content())

    def sees(self, text: str, timeout: float = PATIENCE) -> None:
        """Wait until a text is on the page; topics are served meanwhile."""
        place = self.page.get_by_text(text).first
        try:
            self.until(place.is_visible, f"the page to say {text!r}", timeout)
        except AssertionError as error:
            self.shoot("failed")
            raise AssertionError(f"{error}; it says {self.text()[:2000]}") from None

    def until(self, condition: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
        """Wait for something; topics are served meanwhile."""
        spin_until(self._node, condition, timeout, what, (self.process,))

    def text(self) -> str:
        """All that is written on the page."""
        return str(self.page.evaluate("document.body.innerText"))

    def click(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).first.click(force=True)

    def opens(self, tab: str) -> None:
        """Choose a tab."""
        self.page.get_by_role("tab", name=tab).click(force=True)

    def offers(self, name: str) -> bool:
        """Whether a button is there and may be pressed."""
        button = self.page.get_by_role("button", name=name, exact=True).first
        return bool(button.is_visible() and button.is_enabled())

    def drag(self, pose: Array, axis: int, way: float, camera: Camera) -> None:
        """Take hold of an arrow of the gizmo of an object at `pose` (7,), and pull it `way` m along its axis."""
        with self.holding(pose, axis, way, camera, GIZMO):
            pass

    @contextmanager
    def holding(self, pose: Array, axis: int, way: float, camera: Camera, length: float) -> Iterator[None]:
        """The same with a gizmo of that length, m, held at the end of the way as long as the block lasts."""
        arrow = rotation_matrix(pose[3:])[:, axis]
        begin, end = (pixel(camera, pose[:3] + (HOLD * length + more) * arrow) for more in (0.0, way))
        self.page.mouse.move(*begin)
        self.page.mouse.down()
        self.page.mouse.move(*end, steps=3)
        try:
            yield
        finally:
            self.page.mouse.up()

    def rest(self, seconds: float) -> None:
        """Do nothing for a while, as people do between two looks."""
        self.page.evaluate(f"new Promise((done) => setTimeout(done, {1e3 * seconds}))")

    def stop_box(self) -> dict[str, float]:
        """Where STOP is on the page, in pixels."""
        box: dict[str, float] = self.page.get_by_role("button", name="STOP").first.bounding_box()
        return box

    def sees_stop(self) -> bool:
        """Whether all of STOP is within the window, and nothing lies over it."""
        return bool(
            self.page.evaluate(
                """() => {
                const stop = [...document.querySelectorAll('button')].find(
                    (one) => one.innerText.includes('STOP') && one.getBoundingClientRect().height > 0);
                const box = stop.getBoundingClientRect();
                const over = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
                return box.height > 10 && box.y >= 0 && box.bottom <= window.innerHeight && stop.contains(over);
                }"""
            )
        )

    def scroll_down(self) -> float:
        """Scroll every panel to its end; by how many pixels all in all."""
        return float(
            self.page.evaluate(
                """() => [...document.querySelectorAll('.mantine-ScrollArea-viewport')].map((one) => {
                one.scrollTop = one.scrollHeight; return one.scrollTop;
                }).reduce((sum, one) => sum + one, 0)"""
            )
        )

    def shoot(self, name: str, folder: Path = OUTPUT) -> None:
        """Write a picture of the page."""
        folder.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=folder / f"{name}.png")


def pixel(camera: Camera, point: Array) -> tuple[float, float]:
    """Where a point (3,) of the base frame, m, is on the page."""
    ahead = camera.look_at - camera.position
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = point - camera.position
    scale = HEIGHT / (2.0 * np.tan(0.5 * camera.fov) * float(seen @ ahead))
    return WIDTH / 2.0 + scale * float(seen @ right), HEIGHT / 2.0 - scale * float(seen @ np.cross(right, ahead))


class Places:
    """Where hand and objects are, as their topics say."""

    def __init__(self, node: Node, endpoint: str = "left") -> None:
        self._inbox = {
            name: Inbox(node, PoseStamped, topic, STREAM)
            for name, topic in {
                "hand": f"endpoint/{endpoint}/pose",
                "object": "object/pose",
                "target": "target/pose",
            }.items()
        }

    def of(self, name: str) -> Array:
        """Pose (7,) of one of them."""
        return conversions.pose_to_array(self._inbox[name].last.pose)

    @property
    def are_known(self) -> bool:
        """Whether all of them were told of."""
        return all(inbox.last is not None for inbox in self._inbox.values())
