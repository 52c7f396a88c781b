# SPDX-License-Identifier: Apache-2.0
"""Which frames the tracker refuses to take now, out of the counts of its diagnostics."""

from __future__ import annotations

from collections.abc import Mapping

#: Diagnostics come once per second; a refusal is of now for so long, s.
LASTS = 2.5
_PREFIX = "refused_"


class Refusals:
    """Compares counts of refused poses with those of a moment ago."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._refused: dict[str, tuple[float, str]] = {}

    def take(self, values: Mapping[str, str], now: float) -> None:
        """Take the values of the tracker's diagnostics, at a time in s: ``refused_NAME: KIND`` has a count."""
        for key, value in values.items():
            name, colon, kind = key.removeprefix(_PREFIX).partition(": ")
            if not key.startswith(_PREFIX) or not colon or not value.isdigit():
                continue
            count = int(value)
            # what was refused before the workbench came is of no moment that it knows
            if count > self._counts.get(key, count):
                self._refused[name] = now, kind
            self._counts[key] = count

    def of(self, name: str, now: float) -> str | None:
        """Why poses of a frame are refused at a time in s; None where they are not."""
        since, kind = self._refused.get(name, (float("-inf"), ""))
        return kind if now - since <= LASTS else None
