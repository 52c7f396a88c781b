# SPDX-License-Identifier: Apache-2.0
"""Of several pages one drives: the first that asks for something; another one may take over, and all may stop."""

from __future__ import annotations

import threading


class Driver:
    """Which page drives."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pages: set[int] = set()
        self._driver: int | None = None

    @property
    def number(self) -> int | None:
        """The page that drives; None where nobody does."""
        return self._driver

    @property
    def pages(self) -> int:
        """How many pages are open."""
        return len(self._pages)

    def come(self, page: int) -> None:
        """A page was opened; the only one drives."""
        with self._lock:
            self._pages.add(page)
            if self._driver is None:
                self._driver = page

    def go(self, page: int) -> bool:
        """A page was closed; whether it is the one that drove. Then the only one that is left drives."""
        with self._lock:
            self._pages.discard(page)
            if self._driver != page:
                return False
            self._driver = next(iter(self._pages)) if len(self._pages) == 1 else None
            return True

    def drives(self, page: int | None) -> bool:
        """Whether a page drives; where nobody does, the one that asks drives from now on."""
        with self._lock:
            if self._driver is None:
                self._driver = page
            return page is None or self._driver == page

    def take_over(self, page: int | None) -> None:
        """Let a page drive from now on."""
        with self._lock:
            self._driver = page
