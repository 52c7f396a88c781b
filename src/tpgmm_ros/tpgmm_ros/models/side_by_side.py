# SPDX-License-Identifier: Apache-2.0
"""The same work on several things, in several processes through joblib."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any


def side_by_side[T, R](work: Callable[[T], R], items: Iterable[T], jobs: int = 1) -> Iterator[R]:
    """What comes of each, in the order of the items.

    Parameters
    ----------
    work
        depends on its item alone, so that the number of processes changes nothing
    items
        what is worked on
    jobs
        processes; 1: this one, which does not need joblib

    Yields
    ------
    R
        what comes of an item

    Raises
    ------
    ValueError
        joblib is not installed.
    """
    if jobs == 1:
        yield from map(work, items)
        return
    try:
        import joblib
    except ModuleNotFoundError:
        raise ValueError(
            f"{jobs} processes need joblib, which is not installed: 'pip install joblib', or leave out --jobs"
        ) from None
    found: Iterable[Any] = joblib.Parallel(n_jobs=jobs, return_as="generator")(
        joblib.delayed(work)(item) for item in items
    )
    yield from found
