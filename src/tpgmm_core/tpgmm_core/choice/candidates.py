# SPDX-License-Identifier: Apache-2.0
"""Frames that a movement may be seen from, beside those that are observed: found without being asked for."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.derived_frames import BASE, HAND, DerivedFrames, FrameSource

_STILL = "what stands still"
"""A name that no frame has."""


def frame_candidates(demonstrations: Sequence[Demonstration], declared: DerivedFrames | None = None) -> DerivedFrames:
    """Each observed frame unturned, where the hand starts (unturned), and the base.

    What never moves with respect to a frame that is there already is left out: it would say the same again.

    Parameters
    ----------
    demonstrations
        over [time, point]
    declared
        those of their frames that are derived already

    Returns
    -------
    DerivedFrames
        to be added to the demonstrations' own
    """
    taken = DerivedFrames() if declared is None else declared
    names = tuple(demonstrations[0].frames)
    sources = {
        _free(name, names): source
        for name, source in _sources([name for name in names if name not in taken.sources])
        if source not in taken.sources.values()
    }
    candidates = DerivedFrames(sources)
    extended = [candidates.extended(demonstration) for demonstration in demonstrations]
    kept: dict[str, FrameSource] = {}
    for name, source in sources.items():
        if not any(see_the_same(extended, name, other) for other in (*names, *kept)):
            kept[name] = source
    return DerivedFrames(kept)


def in_order_of_preference(demonstrations: Sequence[Demonstration], derived: DerivedFrames) -> tuple[str, ...]:
    """Names of all frames: of those that explain a movement as well, the first is to be taken.

    What stands still comes first (it cannot be lost, and its noise cannot disturb), then the hand's start, then the
    frames that are observed, then those that are derived of them.

    Returns
    -------
    tuple[str, ...]
        the names, the preferred one first
    """
    still = DerivedFrames({_STILL: FrameSource(BASE)})
    extended = [still.extended(demonstration) for demonstration in demonstrations]

    def rank(name: str) -> int:
        source = derived.sources.get(name)
        if see_the_same(extended, _STILL, name):
            return 0
        if source is None:
            return 2
        return 1 if source.of == HAND else 3

    return tuple(sorted(demonstrations[0].frames, key=rank))


def _sources(observed: Sequence[str]) -> Iterator[tuple[str, FrameSource]]:
    for name in observed:
        yield f"{name}_unturned", FrameSource(name, turned=False)
    yield "hand_start", FrameSource(HAND, turned=False)
    yield "base", FrameSource(BASE)


def _free(name: str, taken: Collection[str]) -> str:
    while name in taken:
        name += "_"
    return name


def see_the_same(demonstrations: Sequence[Demonstration], one: str, other: str) -> bool:
    """Whether two frames never move with respect to each other: what one sees then says all that the other sees.

    Parameters
    ----------
    demonstrations
        with both frames
    one, other
        names of the frames

    Returns
    -------
    bool
        whether they never move with respect to each other
    """
    relative = [_relative(shown.frames[one], shown.frames[other]) for shown in demonstrations]
    A, b = (np.concatenate(parts) for parts in zip(*relative, strict=True))
    return bool(np.allclose(A, A[0], atol=1e-9) and np.allclose(b, b[0], atol=1e-9))


def _relative(one: Frame, other: Frame) -> tuple[Array, Array]:
    """How `one` sees `other`: maps (T or 1, D, D) and offsets (T or 1, D)."""
    inverse = one.pseudo_inverse()
    A = inverse @ other.A
    b = np.einsum("...ij,...j->...i", inverse, other.b - one.b)
    return A.reshape(-1, *A.shape[-2:]), b.reshape(-1, b.shape[-1])
