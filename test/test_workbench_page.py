# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: from an empty folder to a trained and running skill by clicks, keys and drags alone.

The robot is simulated, at 250 Hz, since the browser draws without a graphics card. Skipped where there is no Chromium.
Pictures are written to out/workbench_page/.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from ros_graph import ROOT, Inbox
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_core.geometry.pose import compose, inverse, pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_workbench.page.camera import camera_for
from tpgmm_workbench.project.project import Project

sync_api = pytest.importorskip("playwright.sync_api", reason="no Playwright: `make dev` installs it")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install --no-install-recommends chromium"),
    pytest.mark.timeout(600),
]
OUTPUT = ROOT / "out" / "workbench_page"
WIDTH, HEIGHT = 1000, 640
PATIENCE = 150.0
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]


@pytest.fixture
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield running
        running.close()


class User:
    """Someone at the page, who sees what is on it, and can click, press keys and drag."""

    def __init__(self, browser: Any, node: Node, process: RunningProcess, address: str) -> None:
        self._node, self._process = node, process
        self.page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.asked: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(address)

    def sees(self, text: str, timeout: float = PATIENCE) -> None:
        """Wait until a text is on the page; topics are served meanwhile."""
        place = self.page.get_by_text(text).first
        try:
            self.until(place.is_visible, f"the page to say {text!r}", timeout)
        except AssertionError as error:
            self.shoot("failed")
            raise AssertionError(f"{error}; it says {self.text()[:2000]}") from None

    def until(self, condition: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
        spin_until(self._node, condition, timeout, what, (self._process,))

    def text(self) -> str:
        return str(self.page.evaluate("document.body.innerText"))

    def click(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).first.click(force=True)

    def opens(self, tab: str) -> None:
        self.page.get_by_role("tab", name=tab).click(force=True)

    def shoot(self, name: str) -> None:
        OUTPUT.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=OUTPUT / f"{name}.png")

    def drag(self, begin: np.ndarray, end: np.ndarray, steps: int = 6) -> None:
        """Drag with the mouse from one place in the scene, m, to another."""
        mouse, (x, y) = self.page.mouse, in_picture(begin)
        mouse.move(x, y)
        mouse.down()
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            mouse.move(*in_picture(begin + share * (end - begin)))
        mouse.up()


def in_picture(point: np.ndarray) -> tuple[float, float]:
    """Where a point (3,) of the scene is in the picture, pixels."""
    robot = RobotModel.from_file(ROOT / "config" / "baxter.yaml")
    data = robot.create_data()
    data.update(robot.home)
    camera = camera_for(data.pose("left"))
    ahead = camera.look_at - camera.position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    seen = point - camera.position
    scale = 0.5 * HEIGHT / np.tan(0.5 * camera.fov) / (seen @ ahead)
    return 0.5 * WIDTH + scale * (seen @ right), 0.5 * HEIGHT - scale * (seen @ up)


class Places:
    """Where hand and objects are, as their topics say."""

    def __init__(self, node: Node) -> None:
        self._inbox = {
            name: Inbox(node, PoseStamped, topic, STREAM)
            for name, topic in {
                "hand": "endpoint/left/pose",
                "object": "object/pose",
                "target": "target/pose",
            }.items()
        }

    def of(self, name: str) -> np.ndarray:
        return conversions.pose_to_array(self._inbox[name].last.pose)

    def count(self, name: str) -> int:
        return len(self._inbox[name].messages)

    @property
    def are_known(self) -> bool:
        return all(inbox.last is not None for inbox in self._inbox.values())


def start(start_process: StartProcess, domain: int, folder: Path) -> tuple[RunningProcess, Callable[[], str]]:
    process = start_process(
        sys.executable, "-m", "tpgmm_workbench.simulated", "--project", str(folder),
        "--log", str(folder.parent / "log"),
        "--rate", "250", "--seed", "3", "--frame-rate", "2", "--domain", str(domain), "--port", "18080",
    )  # fmt: skip

    def address() -> str:
        said = [word for word in process.output.split() if word.startswith("http://127.0.0.1:")]
        return said[-1] if said and "Ctrl-C" in process.output else ""

    return process, address


def test_a_newcomer_teaches_trains_and_runs_a_skill(
    browser: Any, ros_node: Node, ros_domain: int, start_process: StartProcess, tmp_path: Path
) -> None:
    began = time.monotonic()
    took: dict[str, float] = {}
    folder = tmp_path / "project"
    process, address = start(start_process, ros_domain, folder)
    places = Places(ros_node)
    spin_until(ros_node, address, PATIENCE, "the address", (process,))
    user = User(browser, ros_node, process, address())
    user.sees("object: seen")
    user.until(lambda: places.are_known, "the poses of hand and objects")
    took["page_s"] = time.monotonic() - began

    # -- teach: lead the hand by clicks, record by a key and by a click, objects elsewhere each time
    grasps = []
    for number in range(1, 4):
        user.click("home")
        user.sees("The hand is there.")
        user.page.keyboard.press("r") if number % 2 else user.click("Record [R]")
        user.sees("recording")
        for goal in ("to object", "to target"):
            user.click(goal)
            user.sees("cm to go")
            user.sees("The hand is there.")
        grasps.append(compose(inverse(places.of("target")), places.of("hand")))
        if number == 2:
            user.shoot("teach")
        user.click("Finish [R]")
        user.until(
            lambda n=number: len(Project.open(folder).demonstrations()) == n, f"demonstration {number} on the disk"
        )
        user.page.keyboard.press("n")
    took["taught_s"] = time.monotonic() - began

    # -- train
    user.opens("Train")
    user.click("Train [T]")
    user.sees("Model 1", 240.0)
    user.shoot("train")
    took["trained_s"] = time.monotonic() - began

    # -- drag an object by its gizmo, in the scene
    before = places.of("target")
    arrow = before[:3] + np.array([0.0, 0.0, 0.13])
    user.drag(arrow, arrow + np.array([0.0, 0.0, 0.05]))
    user.until(lambda: pose_error(places.of("target"), before)[0] > 0.02, "the target to be moved by the mouse")

    # -- preview, then run
    user.opens("Run")
    user.click("Preview [P]")
    user.sees("reachable", 120.0)
    user.shoot("preview")
    user.click("Run [G]")
    user.sees("running", 120.0)
    before = places.of("target")
    arrow = before[:3] + np.array([0.0, 0.0, 0.13])
    user.drag(arrow, arrow - np.array([0.0, 0.0, 0.03]))
    user.shoot("run")
    user.sees("done", 120.0)
    took["ran_s"] = time.monotonic() - began
    wanted = compose(places.of("target"), np.array(np.median(grasps, axis=0)))
    assert pose_error(places.of("hand"), wanted)[0] < 0.03
    assert pose_error(places.of("target"), before)[0] > 0.01

    # -- a frame that is hidden is missing, and the page says so
    user.opens("Teach")
    user.page.get_by_label("hide target").check(force=True)
    user.sees("target: missing")
    seen = places.count("target")
    user.page.get_by_label("hide target").uncheck(force=True)
    user.sees("target: seen")
    assert places.count("target") > seen

    # -- nothing came from elsewhere; closed and opened again, the page knows it all
    outside = [url for url in user.asked if not url.startswith((address(), "data:", "blob:"))]
    assert not outside
    user.page.close()
    again = User(browser, ros_node, process, address())
    again.sees("object: seen")
    again.opens("Train")
    again.sees("Model 1")
    (OUTPUT / "report.json").write_text(json.dumps({name: round(value, 1) for name, value in took.items()}, indent=1))
