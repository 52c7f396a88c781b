# SPDX-License-Identifier: Apache-2.0
"""The frames that all ways of retrieval take: those over [time, data], as `Frame.with_time` makes them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tpgmm_core.frame import Frame


def without_time(frames: Mapping[str, Frame]) -> dict[str, Frame]:
    """The frames' maps of the data alone.

    Raises ValueError for a frame that changes the first dimension or mixes it with others.
    """
    return {name: _without_time(name, frame) for name, frame in frames.items()}


def _without_time(name: str, frame: Frame) -> Frame:
    A, b = frame.A, frame.b
    size, columns = A.shape[-2:]
    mixed = np.abs(A[..., 0, 1:]).max(initial=0.0) + np.abs(A[..., 1:, 0]).max(initial=0.0)
    if min(size, columns) < 2 or mixed > 0.0 or np.any(A[..., 0, 0] != 1.0) or np.any(b[..., 0] != 0.0):
        raise ValueError(
            f"frame {name!r} must leave the first dimension (time or decay) as it is, with A = blkdiag(1, ...) and "
            f"b = [0, ...]: make it by Frame.with_time(); got A {A.shape}, b {b.shape}"
        )
    return Frame(A[..., 1:, 1:], b[..., 1:])
