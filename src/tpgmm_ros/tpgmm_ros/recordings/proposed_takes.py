# SPDX-License-Identifier: Apache-2.0
"""Recordings that seem to hold several movements each, and how they could be cut."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tpgmm_core.observation.takes import Rest, repeats_every, takes_between_rests
from tpgmm_ros.recordings.edits import SUFFIX
from tpgmm_ros.recordings.recording import Recording

MOST_TIMES = 6
"""Takes whose times are written out."""


@dataclass(frozen=True, slots=True)
class SeveralMovements:
    """What is proposed.

    Attributes
    ----------
    entry
        of the task file, for all of the recordings; empty where there is none, or each needs another one
    hints
        which recordings seem to hold several movements, when they are, and what to write, in words
    """

    entry: str = ""
    hints: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The entry as a line of the task file."""
        return f"recordings: {{takes: {self.entry}}}  # several movements in a bag\n"


def several_movements(recordings: Sequence[Recording], rest: Rest | None = None) -> SeveralMovements:
    """Look for pauses of the hand, and for what is shown again and again between them.

    A hand pauses within a demonstration too, such as to grasp. So movements that begin anywhere are not spoken of.

    Parameters
    ----------
    recordings
        uncut
    rest
        what a pause is

    Returns
    -------
    SeveralMovements
        an entry where all recordings that have several movements repeat them
    """
    rest = rest or Rest()
    kinds: Counter[int] = Counter()
    hints = []
    for recording in recordings:
        takes = takes_between_rests(recording.times, recording.movement, rest)
        every = repeats_every(recording.times, recording.movement, takes)
        if every is None:
            continue
        kinds[every] += 1
        kept = takes[::every]
        times = ", ".join(f"[{begin:.2f}, {end:.2f}]" for begin, end in kept[:MOST_TIMES])
        more = f", and {len(kept) - MOST_TIMES} more" if len(kept) > MOST_TIMES else ""
        alike = "each begins" if every == 1 else "every second one begins"
        back = "" if every == 1 else ", and those between lead the hand back"
        hints.append(
            f"{recording.place} holds {len(takes)} movements between pauses of {rest.pause:g} s; {alike} where the "
            f"others do{back}. If these are demonstrations, write 'recordings: {{takes: {_entry(rest, every)}}}' into "
            f"the task file, or 'takes: [{times}]{more}' into {recording.path.name}{SUFFIX}"
        )
    entry = _entry(rest, next(iter(kinds))) if len(kinds) == 1 else ""
    return SeveralMovements(entry, tuple(hints))


def _entry(rest: Rest, every: int) -> str:
    return f"{{still: {rest.pause:.1f}{', every: 2' if every == 2 else ''}}}"
