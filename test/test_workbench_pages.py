# SPDX-License-Identifier: Apache-2.0
"""Ten pages at once, without browsers, which would need the cores: what they show, and who may do what."""

from __future__ import annotations

import asyncio
import os
import signal
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from benchmarks.page_client import open_page
from benchmarks.pages import NOBODY, SEEN, UNHEARD, children, open_pages, serving, show_the_same, stop_from_each

PAGES = 10
pytestmark = [pytest.mark.alone, pytest.mark.timeout(600)]


def test_ten_pages_show_the_same_one_drives_and_each_can_stop(tmp_path: Path) -> None:
    async def use(address: str) -> None:
        async with AsyncExitStack() as stack:
            pages = await open_pages(stack, address, PAGES)
            await show_the_same(pages)
            await stop_from_each(pages)
            await pages[-1].press("object", "to object")
            await pages[-1].until(lambda: "Another page drives" in str(pages[-1].notices), "the refusal")
            assert NOBODY in pages[0].text
            await show_the_same(pages)
            assert sum(page.repeated for page in pages) <= 0.2 * sum(page.messages for page in pages)

    with serving(tmp_path, 18580, ("--no-meshes", "--rate", "250")) as (_, address):
        asyncio.run(use(address))


def test_where_the_robot_is_silent_each_panel_says_what_may_not_be_done_until_it_is_heard_again(tmp_path: Path) -> None:
    async def use(address: str, simulator: int) -> None:
        async with open_page(address) as page:
            await page.until(lambda: SEEN in page.text and UNHEARD not in page.text, "the robot to be heard")
            os.kill(simulator, signal.SIGSTOP)
            await page.until(lambda: not page.offers("object"), "no buttons to lead the hand")
            await page.until(lambda: f"cannot be known: {UNHEARD}" in page.text, "a panel behind it to be told, too")
            os.kill(simulator, signal.SIGCONT)
            await page.until(lambda: page.offers("object"), "the buttons again")
            await page.until(lambda: UNHEARD not in page.text, "the panel behind it to be told")

    with serving(tmp_path, 18581, ("--no-meshes", "--rate", "250")) as (pid, address):
        asyncio.run(use(address, next(one for one, said in children(pid).items() if "baxter_simulator" in said)))
