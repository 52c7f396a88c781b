# SPDX-License-Identifier: Apache-2.0
"""What is sent to pages is sent by one thread, so that pages may come and go meanwhile; the newest of it at last."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest
import viser
from websockets.sync.client import connect

from tpgmm_workbench.page.own_thread import Newest, in_own_thread

PROTOCOL: Any = [f"viser-v{viser.__version__}"]
PATIENCE = 20.0


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    running = viser.ViserServer("127.0.0.1", 28280, verbose=False)
    yield running
    running.stop()


def test_the_newest_thing_is_shown_by_the_servers_own_thread_while_pages_come_and_go(server: viser.ViserServer) -> None:
    text = server.gui.add_html("")
    shown: list[int] = []
    threads: set[int] = set()
    own: list[int] = []
    is_done = threading.Event()

    def show(number: int) -> None:
        text.content = str(number)  # raises where another thread did it while a page came
        shown.append(number)
        threads.add(threading.get_ident())
        if number == 1999:
            is_done.set()

    in_own_thread(server, lambda: own.append(threading.get_ident()))
    views = Newest(server, show)
    for number in range(2000):
        if number % 100 == 0:
            with connect(f"ws://127.0.0.1:{server.get_port()}", subprotocols=PROTOCOL) as page:
                page.recv(PATIENCE)
        views.give(number)
    assert is_done.wait(PATIENCE)
    assert shown == sorted(set(shown)) and text.content == "1999"
    assert threads == set(own) != {threading.get_ident()}
