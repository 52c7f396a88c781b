# SPDX-License-Identifier: Apache-2.0
"""Priority of a process: a control loop that waits for its turn behind other programs misses its ticks."""

from __future__ import annotations

import os
import sys
from pathlib import Path


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
