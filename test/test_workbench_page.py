# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: a demonstration in an empty folder by clicks and keys; `test_workbench_desk.py` goes on.

The robot is simulated, at 250 Hz, since the browser draws without a graphics card. Skipped where there is no Chromium.
Pictures are written to out/workbench_page/.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import viser
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from ros_graph import ROOT, Inbox
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import pose_error
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_workbench.page.access import Access, guarded
from tpgmm_workbench.project.project import Project

sync_api = pytest.importorskip("playwright.sync_api", reason="no Playwright: `make dev` installs it")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install --no-install-recommends chromium"),
    pytest.mark.timeout(600),
    pytest.mark.alone,
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
    """Someone at the page, who sees what is on it, and can click and press keys."""

    def __init__(self, browser: Any, node: Node, process: RunningProcess, address: str) -> None:
        self._node, self._process = node, process
        self.page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.asked: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(address)
        self.page.get_by_text("STOP").first.wait_for()
        self.until(lambda: not self.page.get_by_text("connecting").is_visible(), "the page to be heard")

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

    def sees_stop(self) -> bool:
        """Whether all of STOP is within the window, and nothing lies over it."""
        return bool(
            self.page.evaluate(
                """() => {
                const stop = [...document.querySelectorAll('button')].find((one) => one.innerText.includes('STOP'));
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

    def shoot(self, name: str) -> None:
        OUTPUT.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=OUTPUT / f"{name}.png")


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

    def of(self, name: str) -> Array:
        return conversions.pose_to_array(self._inbox[name].last.pose)

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


def test_a_demonstration_is_taught_by_clicks_and_keys_and_nothing_comes_from_elsewhere(
    browser: Any, ros_node: Node, ros_domain: int, start_process: StartProcess, tmp_path: Path
) -> None:
    folder = tmp_path / "project"
    process, address = start(start_process, ros_domain, folder)
    places = Places(ros_node)
    spin_until(ros_node, address, PATIENCE, "the address", (process,))
    user = User(browser, ros_node, process, address())
    user.sees("object: seen")
    user.until(lambda: places.are_known, "the poses of hand and objects")
    user.shoot("page")

    # lead the hand by clicks, record by a key
    begin = places.of("hand")
    user.page.keyboard.press("r")
    user.sees("recording")
    user.click("to object")
    user.until(lambda: pose_error(places.of("hand"), places.of("object"))[0] < 0.035, "the hand to be at the object")
    assert pose_error(places.of("hand"), begin)[0] > 0.05
    user.shoot("teach")
    user.page.keyboard.press("r")
    user.until(lambda: len(Project.open(folder).demonstrations()) == 1, "the demonstration on the disk")

    # a frame that is hidden is missing, and the page says so
    user.page.get_by_label("hide target").check(force=True)
    user.sees("target: missing")
    user.page.get_by_label("hide target").uncheck(force=True)
    user.sees("target: seen")
    user.shoot("taught")

    # a comment is kept, whose letters are no keys; the project comes as a file
    user.page.get_by_text("Notes of one demonstration").click(force=True)
    comment = user.page.locator("xpath=//*[text()='comment']/following::input[1]")
    user.until(comment.is_visible, "the notes to be opened")
    comment.focus()  # keys, since words that come and go move what a mouse would hit
    comment.press_sequentially("roundabout")
    user.page.evaluate("new Promise((done) => setTimeout(done, 200))")  # viser sends what is typed 50 ms later
    user.page.get_by_role("button", name="Keep these notes", exact=True).press("Enter")
    user.until(lambda: Project.open(folder).demonstration(1).notes.comment == "roundabout", "the comment on the disk")
    assert len(Project.open(folder).used()) == 1
    user.shoot("notes")
    assert user.sees_stop()
    assert user.scroll_down() > 0.0 and user.sees_stop()
    user.page.get_by_role("tab", name="Share").click(force=True)
    with user.page.expect_download() as got:
        user.click("Export this project")
    archive = tmp_path / got.value.suggested_filename
    got.value.save_as(archive)
    with user.page.expect_file_chooser() as chooser:
        user.click("Import a project")
    chooser.value.set_files(archive)
    user.sees("imported into")
    user.shoot("share")
    assert len(Project.open(folder.parent / "project_2").demonstrations()) == 1

    # the torques that carry the arm stand beside their limits
    user.page.get_by_role("tab", name="Robot").click(force=True)
    user.sees("left_s0:")
    assert "of 50 N m" in user.text(), user.text()
    user.shoot("robot")

    # nothing came from elsewhere; closed and opened again, the page knows it all
    assert user.asked
    assert not [url for url in user.asked if not url.startswith((address(), "data:", "blob:"))]
    user.page.close()
    again = User(browser, ros_node, process, address())
    again.sees("Show the movement 3 more times")


def test_a_page_that_is_open_to_other_machines_is_seen_with_its_token_alone_which_leaves_the_address(
    browser: Any,
) -> None:
    access = Access("127.0.0.2")  # an address of this machine that counts as one of a network
    with guarded(access):
        server = viser.ViserServer(access.host, 18280, verbose=False)
    try:
        server.gui.add_button("Record")
        address = access.address(server.get_port())
        plain = address.partition("?")[0]
        page = browser.new_page()
        page.goto(plain)
        page.get_by_text("needs its token").wait_for()
        page.goto(address)
        page.get_by_role("button", name="Record").wait_for()  # it comes by the web socket
        assert page.url == plain
        page.goto(plain)
        page.get_by_role("button", name="Record").wait_for()
        stranger = browser.new_context().new_page()
        stranger.goto(plain)
        stranger.get_by_text("needs its token").wait_for()
    finally:
        server.stop()
