# SPDX-License-Identifier: Apache-2.0
"""One retrieval that continues from another, and starts afresh when it is told to."""

from __future__ import annotations

import numpy as np

from reaching import frames_at, place, reaching_model
from tpgmm_core.retrieval.continued import Continued
from tpgmm_core.retrieval.reproduction import Reproduction

MS = 1_000_000
HERE = frames_at(start=place(0.0, 0.0, 0.0), object=place(0.5, 0.1, 0.4))
THERE = frames_at(start=place(0.0, 0.1, 0.0), object=place(0.6, -0.1, -0.4))


def started() -> Reproduction:
    reproduction = Reproduction(reaching_model())
    reproduction.start(0)
    return reproduction


def test_a_new_start_during_a_takeover_is_exactly_the_new_movement() -> None:
    former = started().step(500 * MS, HERE)
    continued = Continued(started(), former, 500 * MS, time_constant=0.3)
    plain = started()
    taken_over = [continued.step(ms * MS, THERE).gaussian.mean for ms in range(501, 520)]
    assert np.abs(taken_over[-1] - plain.step(519 * MS, THERE).gaussian.mean).max() > 0.01
    continued.start(1_000 * MS)
    plain.start(1_000 * MS)
    for ms in (1_000, 1_010, 1_400):
        again, expected = continued.step(ms * MS, THERE), plain.step(ms * MS, THERE)
        np.testing.assert_array_equal(again.gaussian.mean, expected.gaussian.mean)
        np.testing.assert_array_equal(again.gaussian.covariance, expected.gaussian.covariance)
