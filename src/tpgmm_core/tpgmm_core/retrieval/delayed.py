# SPDX-License-Identifier: Apache-2.0
"""`Delayed`: a movement that waits at its beginning, on whichever method it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.wrapped import Wrapped

_SECOND = 1_000_000_000


class Delayed(Wrapped):
    """A `Retrieval` whose time does not pass for a while after it was started.

    Parameters
    ----------
    retrieval
        the movement, started
    start_ns
        when it was started, ns
    delay_ns
        for how long it waits, ns
    """

    def __init__(self, retrieval: Retrieval, start_ns: int, delay_ns: int) -> None:
        super().__init__(retrieval)
        self._start_ns, self._delay_ns = start_ns, delay_ns
        self._waits = 0.0  # s, from the last step on
        self._present: Gaussian | None = None

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Start it afresh, without waiting: see `Retrieval.start`."""
        self._start_ns, self._delay_ns = time_ns, 0
        self._retrieval.start(time_ns, state, phase)

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time: that of the beginning as long as it waits; see `Retrieval.step`."""
        late_ns = time_ns - self._delay_ns
        self._waits = max(0, self._start_ns - late_ns) / _SECOND
        reference = self._retrieval.step(max(self._start_ns, late_ns), frames, state, weights)
        self._present = reference.gaussian
        if self._waits == 0.0 or not reference.horizon:
            return reference
        return replace(reference, horizon=tuple(self.horizon(len(reference.horizon), reference.horizon_time_step)))

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart: see `Retrieval.horizon`; it goes nowhere while it waits."""
        ahead = self._retrieval.horizon(n, dt)
        if self._present is None:
            return ahead
        still = min(n, round(self._waits / dt))
        return [*[self._present] * still, *ahead[: n - still]]
