# SPDX-License-Identifier: Apache-2.0
"""Whatever is pressed, typed and dragged on the page, in whatever order, whichever node is silent: the page goes on.

Pages without browsers try everything that a page has been sent, so that a new button is tried without a word here. No
error is written that nobody has thought of, and in the end the hand is led and stopped from each page. `make fuzz`
tries more.
"""

from __future__ import annotations

import asyncio
import os
import random
import signal
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from benchmarks.page_client import PageClient
from benchmarks.pages import SEEN, UNHEARD, children, open_pages, serving, stop_from_each
from ros_graph import ROBOT_FILE, ROOT, TASK_FILE
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.training_process import TrainingOptions, train

#: Things that are tried.
COUNT, SEED = int(os.environ.get("TPGMM_FUZZ_EXAMPLES", "100")), 1
PAGES = 2
#: A node is silent for so long, s, once in so many tries.
SILENCE, SELDOM = 1.0, 12
NUMBERS = (0.0, -1.0, 1.0, 7.3, 40.0, 1e-320, 1e308, -1e308, 1e12)
TEXTS = ("", "a", "\N{SNOWMAN}" * 3, "<script>alert(1)</script>", "../../x", "x" * 5000, "\x00\n")
GIZMOS = "/gizmos/"
pytestmark = [pytest.mark.alone, pytest.mark.timeout(300 + COUNT)]


def something(page: PageClient, rng: random.Random) -> dict[str, Any]:
    """A message that someone at this page may send."""
    gizmos = sorted({of for of, _ in page.scene if of.startswith(GIZMOS) and of.count("/") == 2})
    if gizmos and rng.random() < 0.25:
        step = rng.choice(("DragStart", "Update", "Update", "DragEnd"))
        placed = (
            {"position": tuple(rng.choice((0.0, 0.3, -2.0, 1e3)) for _ in range(3)), "wxyz": (1.0, 0.0, 0.0, 0.0)}
            if step == "Update"
            else {}
        )
        return {"type": f"TransformControls{step}Message", "name": rng.choice(gizmos), "owner": "", **placed}
    offered = {of for of, key in page.panels if key in ("options", "hotkey", "label")}
    offered -= {of for of, key in page.panels if key == "mime_type"}  # files come in messages of another kind
    of = rng.choice(sorted(of for of in offered if not isinstance(page.panels.get((of, "value")), list | tuple)))
    has = {key: value for (one, key), value in page.panels.items() if one == of}
    if "hotkey" in has:
        return {"type": "CommandTriggerMessage", "uuid": of}
    value = has.get("value")
    choice: Any = True
    if "options" in has:
        choice = rng.choice(list(has["options"]))
    elif isinstance(value, bool):
        choice = rng.random() < 0.5
    elif isinstance(value, int | float):
        choice = rng.choice(NUMBERS)
    elif isinstance(value, str):
        choice = rng.choice(TEXTS)
    return {"type": "GuiUpdateMessage", "uuid": of, "updates": {"value": choice}}


async def try_all(pages: list[PageClient], nodes: list[int], rng: random.Random) -> None:
    for _ in range(COUNT):
        await rng.choice(pages).send(something(rng.choice(pages), rng))
        await asyncio.sleep(rng.choice((0.0, 0.0, 0.05, 0.3)))
        if rng.randrange(SELDOM) == 0:
            node = rng.choice(nodes)
            os.kill(node, signal.SIGSTOP)
            await asyncio.sleep(SILENCE)
            os.kill(node, signal.SIGCONT)


def teach(folder: Path) -> None:
    """A project with a model: there is more that may be done."""
    project = Project.create(folder, TASK_FILE, ROBOT_FILE)
    for bag in sorted((ROOT / "bags" / "pick_place").glob("demo_*"))[:3]:
        project.add_bag(bag)
    train(project, TrainingOptions(is_automatic=False), lambda share, words: None)


def test_whatever_is_done_on_the_page_it_goes_on(tmp_path: Path) -> None:
    async def use(address: str, nodes: list[int]) -> None:
        async with AsyncExitStack() as stack:
            pages = await open_pages(stack, address, PAGES)
            await pages[0].until(lambda: SEEN in pages[0].text, "the robot and its camera")
            await try_all(pages, nodes, random.Random(SEED))
            await pages[0].press("STOP")
        async with AsyncExitStack() as stack:
            pages = await open_pages(stack, address, PAGES)
            await pages[0].until(lambda: UNHEARD not in pages[0].text, "the robot to be heard again")
            for name in ("object", "target"):
                await pages[0].set(f"hide {name}", False)
            if "Then press Finish" in pages[0].text:  # a page that is closed ends no recording
                await pages[0].key("R")
            await stop_from_each(pages)

    teach(tmp_path / "project")
    with serving(tmp_path, 18582, ("--no-meshes", "--rate", "250")) as (pid, address):
        asyncio.run(use(address, list(children(pid))))
