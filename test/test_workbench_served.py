# SPDX-License-Identifier: Apache-2.0
"""How a page is served, in a real browser, without a robot: to whom, and with what is added so that it can be read."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import viser

from tpgmm_workbench.page.access import Access, guarded
from tpgmm_workbench.page.added import completed
from tpgmm_workbench.page.picture import draw_of
from tpgmm_workbench.scene.colors import Color, contrast

pytestmark = [pytest.mark.timeout(600), pytest.mark.alone]


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


@pytest.mark.parametrize("is_dark", [False, True])
def test_buttons_and_tabs_can_be_read_in_light_and_dark(browser: Any, is_dark: bool) -> None:
    access = Access()
    with guarded(access, completed):
        server = viser.ViserServer(access.host, 18281, verbose=False)
    try:
        server.gui.configure_theme(dark_mode=is_dark)
        for color in ("red", "blue", "green", "orange", None):
            server.gui.add_button(f"try {color}", color=color)
        server.gui.add_button("try disabled", disabled=True)
        tabs = server.gui.add_tab_group()
        for name in ("try selected", "try another"):
            with tabs.add_tab(name):
                server.gui.add_button(f"in {name}")
        page = browser.new_page()
        page.goto(access.address(server.get_port()))
        page.get_by_role("button", name="try disabled").wait_for()
        page.get_by_role("tab", name="try another").wait_for()
        found = page.evaluate(
            """() => {
            const ground = (one) => {
                const color = getComputedStyle(one).backgroundColor;
                return color === "rgba(0, 0, 0, 0)" && one.parentElement ? ground(one.parentElement) : color;
            };
            const all = [...document.querySelectorAll("button, [role=tab]")];
            return all.filter((one) => one.innerText.startsWith("try")).map((one) => {
                const text = [...one.querySelectorAll("*"), one].find((part) => part.innerText === one.innerText);
                return [one.innerText, getComputedStyle(text).color, ground(one)];
            });
            }"""
        )
    finally:
        server.stop()
    assert len(found) == 8
    read = {name: contrast(*(_rgb(text) for text in colors)) for name, *colors in found}
    assert min(read.values()) >= 4.5, read


def _rgb(text: str) -> Color:
    red, green, blue = (int(part) for part in re.findall("[0-9]+", text)[:3])
    return red, green, blue


def test_a_browser_draws_the_scene_when_it_is_asked_and_one_that_is_gone_is_told_of(browser: Any) -> None:
    server = viser.ViserServer("127.0.0.1", 18282, verbose=False)
    try:
        server.scene.add_icosphere("/ball", 0.5, (213, 94, 0))
        page = browser.new_page(viewport={"width": 320, "height": 240})
        page.goto(f"http://127.0.0.1:{server.get_port()}")
        while not server.get_clients():
            page.wait_for_timeout(50)
        (client,) = server.get_clients().values()
        with ThreadPoolExecutor() as pool:
            drawn = pool.submit(draw_of(client))
            while not drawn.done():
                page.wait_for_timeout(50)
            picture = drawn.result()
            assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8
            red, green, blue = picture[120, 160].astype(int)
            assert red > green > blue, "the ball is in the middle"
            draw = draw_of(client)
            page.close()
            with pytest.raises(RuntimeError, match="its page was closed"):
                pool.submit(draw).result()
    finally:
        server.stop()
