# SPDX-License-Identifier: Apache-2.0
"""Tests that repeat a shorter one in further situations: `make long` runs them, `make test` leaves them out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_long(values: Iterable[Any], *short: Any) -> list[Any]:
    """Parameters of a test, of which `make test` takes the short ones only; tuples for several parameters."""
    values = list(values)
    assert all(value in values for value in short), f"{short} are not among {values}"
    return [value if value in short else _long(value) for value in values]


def _long(value: Any) -> Any:
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.long)
