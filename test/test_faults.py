# SPDX-License-Identifier: Apache-2.0
"""The quick rows of the table of faults; `make faults` runs all of it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from faults.table import Benches, Fault, all_faults


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Benches]:
    with contextlib.closing(Benches(tmp_path_factory.mktemp("faults"))) as benches:
        yield benches


@pytest.mark.parametrize("row", [row for row in all_faults() if row.quick], ids=lambda row: row.name)
def test_what_is_promised_is_observed(benches: Benches, row: Fault) -> None:
    print(benches.run(row))
