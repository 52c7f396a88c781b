# SPDX-License-Identifier: Apache-2.0
"""Whether somebody holds the hand: a force that lasts, where there was none before. Time is an argument."""

from __future__ import annotations

#: Below this share of the threshold a hand that nobody has held yet is free, and below that one who held it lets go. An
#: arm that yields pulls only a little, and so does the person then.
FREE, LETS_GO = 0.5, 0.2
#: A force above the threshold for so long is a hold, one that is gone for so long is let go of; and so long the hand
#: has to be free before it can be taken hold of, s.
HOLD_TIME, RELEASE_TIME, FREE_TIME = 0.15, 0.6, 0.3


class Touch:
    """See the module.

    Parameters
    ----------
    threshold
        N; 0: nobody ever holds the hand

    Attributes
    ----------
    is_held
        whether somebody holds the hand
    is_felt
        whether there is a force now: who holds the hand may let it slip for a moment
    is_ready
        whether the hand was free since it is looked at: a weight that the robot file does not know, or torques that
        are measured badly, push from the beginning
    """

    def __init__(self, threshold: float) -> None:
        self.threshold = threshold
        self.forget()

    @property
    def free(self) -> float:
        """Force below which nobody holds the hand at present, N."""
        return (LETS_GO if self.is_held else FREE) * self.threshold

    def forget(self) -> None:
        """Nothing is known of the hand."""
        self.is_held = self.is_felt = self.is_ready = False
        self._since: float | None = None

    def take(self, now: float, force: float | None) -> None:
        """Take in one moment.

        Parameters
        ----------
        now
            s
        force
            on the hand, N; None where that is not known
        """
        if self.threshold <= 0.0 or force is None:
            self.forget()
            return
        self.is_felt = force >= self.free
        if self.is_held or not self.is_ready:
            changes, lasts = not self.is_felt, RELEASE_TIME if self.is_held else FREE_TIME
        else:
            changes, lasts = force > self.threshold, HOLD_TIME
        if not changes:
            self._since = None
            return
        self._since = now if self._since is None else self._since
        if now - self._since < lasts:
            return
        self._since = None
        if self.is_ready:
            self.is_held = not self.is_held
        self.is_ready = True
