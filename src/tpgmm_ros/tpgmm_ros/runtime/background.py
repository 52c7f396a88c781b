# SPDX-License-Identifier: Apache-2.0
"""Work that would keep a step waiting: in a thread of its own, its outcome back in the thread of the executor."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from rclpy.node import Node

from tpgmm_ros.runtime.composition import guarded
from tpgmm_ros.runtime.scheduling import yield_realtime

_SWITCH_INTERVAL = 2e-4
"""How long one thread's Python may keep the other's waiting, s. Python's own 5 ms would be five steps at 1 kHz."""


class Background:
    """One thread that does what it is given, one after the other, for a node.

    Parameters
    ----------
    node
        its executor calls back
    """

    def __init__(self, node: Node) -> None:
        sys.setswitchinterval(_SWITCH_INTERVAL)
        self._node = node
        self._open = True
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="background", initializer=yield_realtime)

    def run[ResultT](self, work: Callable[[], ResultT], then: Callable[[Future[ResultT]], None]) -> None:
        """Do the work in the background.

        ``then`` gets it in the executor's thread, where ``result()`` gives what it returned or raises what it raised.
        Nothing is called after ``close``.
        """

        def finish(job: Future[ResultT]) -> None:
            if self._open:
                then(job)

        def hand_over(job: Future[ResultT]) -> None:
            executor = self._node.executor
            if executor is not None:
                executor.create_task(guarded(self._node, finish), job)

        self._pool.submit(work).add_done_callback(hand_over)

    def submit[ResultT](self, work: Callable[[], ResultT]) -> Future[ResultT]:
        """Do the work in the background; the future says when it is done."""
        return self._pool.submit(work)

    def close(self) -> None:
        """Forget what is being done and all the rest, without waiting: other nodes of the process have to go on."""
        self._open = False
        self._pool.shutdown(wait=False, cancel_futures=True)
