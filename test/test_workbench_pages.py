# SPDX-License-Identifier: Apache-2.0
"""Ten pages at once, without browsers, which would need the cores: what they show, and who may do what."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from benchmarks.pages import NOBODY, open_pages, serving, show_the_same, stop_from_each

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
