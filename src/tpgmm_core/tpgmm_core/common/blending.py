# SPDX-License-Identifier: Apache-2.0
"""From 0 to 1 without a jump of the rate, for what is blended in and out, and for movements from rest to rest."""

from __future__ import annotations

from tpgmm_core.common.types import Array


def smoothstep[Share: (float, Array)](share: Share) -> Share:
    """3 s² - 2 s³ of shares s from 0 to 1: from 0 to 1 too, with slope zero at both ends."""
    return share * share * (3.0 - 2.0 * share)


def minimum_jerk(share: float) -> float:
    """10 s³ - 15 s⁴ + 6 s⁵ of a share s, of one below 0 as of 0, of one above 1 as of 1 (Flash and Hogan 1985)."""
    s = min(1.0, max(0.0, share))
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
