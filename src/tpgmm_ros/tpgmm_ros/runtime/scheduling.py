# SPDX-License-Identifier: Apache-2.0
"""What a control loop asks of the system: its turn ahead of others, cores of its own, memory that stays there.

A loop that waits for its turn behind other programs, or for a page of memory, misses its ticks.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from pathlib import Path

from tpgmm_core.common.text import listed, shown

_MCL_CURRENT, _MCL_FUTURE = 1, 2  # sys/mman.h
_CORES = re.compile(r"(?P<first>[0-9]{1,4})(-(?P<last>[0-9]{1,4}))?")


def cores_of(text: str) -> set[int]:
    """Numbers of cores, as in ``0,2-3``; none for an empty text.

    Parameters
    ----------
    text
        numbers and ranges, separated by commas

    Returns
    -------
    set[int]
        the numbers

    Raises
    ------
    ValueError
        Something else, or cores that this process may not use.
    """
    cores: set[int] = set()
    for part in filter(None, text.replace(" ", "").split(",")):
        if not (found := _CORES.fullmatch(part)):
            raise ValueError(f"cpu_cores is {shown(text)}; expected numbers and ranges of cores, such as 0,2-3")
        first, last = found["first"], found["last"]
        cores |= set(range(int(first), int(last or first) + 1))
    allowed = os.sched_getaffinity(0) if sys.platform == "linux" else cores
    if cores - allowed:
        raise ValueError(f"cpu_cores is {shown(text)}; this process may use {listed(map(str, sorted(allowed)))}")
    return cores


def run_on(cores: set[int]) -> None:
    """Run all threads of this process on these cores only, and those that they start."""
    if sys.platform == "linux":
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setaffinity(int(thread.name), cores)


def lock_memory() -> str:
    """Keep all memory of this process where it is, now and from now on: no step waits for a page.

    Returns
    -------
    str
        empty, or why it was refused; then the process goes on without
    """
    try:
        refused = ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_FUTURE)
    except (OSError, AttributeError, TypeError) as error:  # a system without this call
        return str(error)
    if refused:
        reason = os.strerror(ctypes.get_errno())
        return f"{reason}; it needs CAP_IPC_LOCK, or 'memlock' in /etc/security/limits.conf"
    return ""


def request_realtime(priority: int) -> str:
    """Ask the system to run all threads of this process ahead of ordinary ones (SCHED_FIFO).

    Parameters
    ----------
    priority
        1 (least) to 99

    Returns
    -------
    str
        An empty text, or why it was refused; then the process goes on as an ordinary one
    """
    try:
        # The middleware's threads too: a message that waits for them is as late as one that waits for us.
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:  # AttributeError: a system without these calls
        return f"{error}; it needs CAP_SYS_NICE, or 'rtprio' in /etc/security/limits.conf"
    return ""


def end_realtime() -> None:
    """Run as an ordinary program again, all threads of this process: what follows has no deadlines."""
    if sys.platform == "linux":
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))


def yield_realtime() -> None:
    """Have the calling thread, where it has such a priority, run behind all loops: still ahead of ordinary programs.

    A new thread inherits the priority of the one that starts it. One that computes for long would keep a core to
    itself, and the loops of the other nodes would wait.
    """
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
