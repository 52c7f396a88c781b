# SPDX-License-Identifier: Apache-2.0
"""Priority of a process: a control loop that waits for its turn behind other programs misses its ticks."""

from __future__ import annotations

import os
from pathlib import Path


def request_realtime(priority: int) -> str:
    """Ask the system to run all threads of this process ahead of ordinary ones (SCHED_FIFO).

    Args:
        priority: 1 (least) to 99.

    Returns:
        An empty text, or why it was refused; then the process goes on as an ordinary one.
    """
    try:
        # The middleware's threads too: a message that waits for them is as late as one that waits for us.
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:  # AttributeError: a system without these calls
        return f"{error}; it needs CAP_SYS_NICE, or 'rtprio' in /etc/security/limits.conf"
    return ""
