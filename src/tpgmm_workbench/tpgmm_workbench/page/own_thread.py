# SPDX-License-Identifier: Apache-2.0
"""What is sent to pages is sent by the server's own thread.

viser wakes its senders from whichever thread changes something, which is not safe: where a page comes or goes at that
moment, the change raises "deque mutated during iteration", and would end the node. Its event loop does one thing at a
time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from viser import ViserServer


def in_own_thread(server: ViserServer, method: Callable[..., object], *arguments: Any) -> None:
    """Have something called by the server's own thread, soon; from any thread."""
    server.get_event_loop().call_soon_threadsafe(method, *arguments)


class Newest[T]:
    """Shows things in the server's own thread: the newest one, where several come before it is free.

    Parameters
    ----------
    server
        of the pages
    show
        called with a thing
    """

    def __init__(self, server: ViserServer, show: Callable[[T], object]) -> None:
        self._server, self._show = server, show
        self._lock = threading.Lock()
        self._waiting: list[T] = []

    def give(self, thing: T) -> None:
        """Have a thing shown; returns at once."""
        with self._lock:
            is_asked = bool(self._waiting)
            self._waiting = [thing]
        if not is_asked:
            in_own_thread(self._server, self._take)

    def _take(self) -> None:
        with self._lock:
            things, self._waiting = self._waiting, []
        for thing in things:
            self._show(thing)
