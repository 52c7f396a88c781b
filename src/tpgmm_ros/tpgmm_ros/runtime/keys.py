# SPDX-License-Identifier: Apache-2.0
"""Keys of a terminal, one by one as they are pressed; without a terminal there are none."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator

LINE_START = "\r\x1b[K"
"""Goes to the beginning of a terminal's line, and clears it."""


class Keys:
    """The keys that were pressed since they were last asked for."""

    def __init__(self, source: int | None) -> None:
        self._source = source

    @property
    def there(self) -> bool:
        """Whether there is a terminal to press them at."""
        return self._source is not None

    def pressed(self) -> str:
        """Those that wait, in their order; Enter is a line feed."""
        found = b""
        while self._source is not None and select.select([self._source], [], [], 0.0)[0]:
            part = os.read(self._source, 64)
            if not part:  # the terminal has gone
                self._source = None
            found += part
        return found.decode(errors="replace").replace("\r", "\n")


@contextlib.contextmanager
def keys_of_terminal() -> Iterator[Keys]:
    """Keys of standard input from ``with`` to its end, where that is a terminal; then it is as it was before.

    Yields
    ------
    Keys
        what is pressed
    """
    if not sys.stdin or not sys.stdin.isatty():
        yield Keys(None)
        return
    source = sys.stdin.fileno()
    before = termios.tcgetattr(source)
    try:
        tty.setcbreak(source)  # Ctrl-C stays a signal
        yield Keys(source)
    finally:
        termios.tcsetattr(source, termios.TCSADRAIN, before)
