# SPDX-License-Identifier: Apache-2.0
"""What pages ask for is heard in the order in which it came.

viser gives plain functions that it calls back to a pool of threads: STOP, pressed after Run, could be heard before it,
and what a control was set to could have changed since. Coroutines are called by the event loop that receives.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any


def in_order[E](heard: Callable[[E], object]) -> Callable[[E], Coroutine[Any, Any, None]]:
    """Have what pages do heard by the server's own thread, in the order in which it came from all of them.

    Parameters
    ----------
    heard
        called with an event of viser; it returns at once

    Returns
    -------
    Callable[[E], Coroutine[Any, Any, None]]
        to be given to viser
    """

    async def called(event: E) -> None:
        heard(event)

    return called
