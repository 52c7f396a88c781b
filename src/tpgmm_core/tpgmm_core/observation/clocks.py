# SPDX-License-Identifier: Apache-2.0
"""`LeadMeter`: stamps that are ahead of the clock of whoever receives them, steadily: the sender's clock is ahead.

Nothing arrives before it was seen. Where a stamp says so, one of two clocks is wrong, and if all stamps of a stream are
ahead by the same time, this time is known. Stamps that are behind say nothing: an old image and an old clock look
alike, so these are never corrected here.
"""

from __future__ import annotations

from collections import deque

from tpgmm_core.observation.streams import SECOND

#: How many stamps have to be ahead by the same time.
ENOUGH = 10
#: Times that differ by no more are the same: the way of a message takes longer now and then, s.
SPREAD = 0.05
#: A clock that is further ahead is another clock, such as that of a simulation or of another day, s.
MOST = 0.5


class LeadMeter:
    """Learns by how much the clock of one sender is ahead."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self._leads: deque[int] = deque(maxlen=ENOUGH)
        self.lead_ns = 0

    def corrected(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """The stamp by the clock of the receiver, for a stamp that is ahead.

        Parameters
        ----------
        stamp_ns
            of a message, after `arrival_ns`
        arrival_ns
            when it came, by the receiver's clock, ns

        Returns
        -------
        int or None
            ns, not after the arrival; None where the lead is not steady, not known yet, or no clock's
        """
        self._leads.append(stamp_ns - arrival_ns)
        if len(self._leads) < ENOUGH or max(self._leads) - min(self._leads) > SPREAD * SECOND:
            return None
        if max(self._leads) > MOST * SECOND:
            return None
        # it stays as it is while it is nearly right, so that intervals between corrected stamps are the sender's
        if not 0 <= self.lead_ns - max(self._leads) <= SPREAD * SECOND:
            self.lead_ns = max(self._leads)
        return stamp_ns - self.lead_ns
