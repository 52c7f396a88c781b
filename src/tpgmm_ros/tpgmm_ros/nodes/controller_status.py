# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller tells on `/diagnostics` beside its mode: how late it is, and what limits took away."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tpgmm_core.control.loop_guard import LoopGuard
from tpgmm_ros.runtime.monitor import Samples


def loop_values(guard: LoopGuard, ages: Samples) -> dict[str, str]:
    """How old joint states are by their stamps, what the gains in use would bear, and what share of them is in use."""
    values = {"state_age_p50_ms": "unknown", "state_age_p99_ms": "unknown"}
    if ages.count and guard.age.age is not None:
        p50, p99 = ages.percentile_ms(50, 99)
        values = {"state_age_p50_ms": f"{p50:.2f}", "state_age_p99_ms": f"{p99:.2f}"}
    followed = math.isfinite(guard.tolerated)
    values["tolerated_age_ms"] = f"{1e3 * guard.tolerated:.1f}" if followed else "no reference"
    values["state_period_ms"] = f"{1e3 * guard.age.period:.2f}"
    values["gain_share"] = f"{guard.share:.2f}"
    if guard.age.suspected > 1e-3:
        values["suspected_delay_ms"] = f"{1e3 * guard.age.suspected:.0f}"
    return values


def limited(actions: Mapping[str, int]) -> str:
    """How often each stage of the pipeline took something away."""
    return ", ".join(f"{name}: {count} ticks" for name, count in sorted(actions.items()))
