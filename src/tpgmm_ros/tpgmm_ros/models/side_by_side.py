# SPDX-License-Identifier: Apache-2.0
"""The same work on several things, in several processes or on a cluster, through joblib."""

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
        processes, or whatever a backend of joblib's that the caller has chosen takes for them; 1: this process

    Yields
    ------
    R
        what comes of an item
    """
    if jobs == 1:
        yield from map(work, items)
        return
    import joblib  # takes 0.1 s, which one process needs not spend

    found: Iterable[Any] = joblib.Parallel(n_jobs=jobs, return_as="generator")(
        joblib.delayed(work)(item) for item in items
    )
    yield from found
