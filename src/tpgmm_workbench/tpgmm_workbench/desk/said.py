# SPDX-License-Identifier: Apache-2.0
"""What the user was told last, for as long as it is news."""

from __future__ import annotations

import time

from rclpy.node import Node

#: What was said is shown for so long, s; and how much of it at once.
WORDS_STAY, MOST_WORDS = 12.0, 3


class Said:
    """Words for the user.

    Parameters
    ----------
    node
        whose log has them too
    """

    def __init__(self, node: Node) -> None:
        self._log = node.get_logger()
        self._said: list[tuple[float, str]] = []

    def say(self, words: str) -> None:
        """Tell the user something, and the log."""
        self._log.info(words)
        self._said.append((time.monotonic(), words))

    @property
    def recent(self) -> tuple[str, ...]:
        """What is news, newest first."""
        now = time.monotonic()
        self._said = [(when, words) for when, words in self._said[-MOST_WORDS:] if now - when < WORDS_STAY]
        return tuple(words for _, words in reversed(self._said))
