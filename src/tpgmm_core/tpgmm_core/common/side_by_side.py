# SPDX-License-Identifier: Apache-2.0
"""The same work on several things, in several processes or on a cluster, through joblib."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import Any


def side_by_side[T, R](
    work: Callable[[T], R], items: Iterable[T], jobs: int = 1, *, in_order: bool = True
) -> Iterator[R]:
    """What comes of each, as soon as it is there.

    As many items as there are processes are taken at a time, the next one when one is done: they may be read, or made,
    only then. Processes are ended where the caller stops early, as by KeyboardInterrupt.

    Parameters
    ----------
    work
        depends on its item alone, so that the number of processes changes nothing
    items
        what is worked on; gone through by another thread where there are several jobs
    jobs
        processes, or whatever a backend of joblib's that the caller has chosen takes for them; 1: this process
    in_order
        in the order of the items; otherwise in the order in which they are done

    Yields
    ------
    R
        what comes of an item
    """
    if jobs == 1:
        yield from map(work, items)
        return
    import joblib  # takes 0.1 s, which one process needs not spend

    shielded = joblib.delayed(_Shielded(work, os.getpid()))
    found: Iterable[Any] = joblib.Parallel(
        n_jobs=jobs,
        return_as="generator" if in_order else "generator_unordered",
        pre_dispatch="n_jobs",
        batch_size=1,
        max_nbytes=None,  # large items go through pipes: files in /dev/shm would stay there until the end of all
    )(shielded(item) for item in items)
    with warnings.catch_warnings():
        # joblib warns where not all is asked for that was begun, which is what an early end means
        warnings.filterwarnings("ignore", module="joblib")
        yield from found


class _Shielded[T, R]:
    """Work in a process that leaves it to the first one what an interruption from the keyboard means."""

    def __init__(self, work: Callable[[T], R], first_process: int) -> None:
        self._work, self._first_process = work, first_process

    def __call__(self, item: T) -> R:
        if os.getpid() != self._first_process and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        return self._work(item)
