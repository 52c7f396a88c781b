# SPDX-License-Identifier: Apache-2.0
"""The frames that all retrieval methods use: those over [time, data], as `Frame.with_time` makes them."""

from __future__ import annotations

from collections.abc import Mapping

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model import kernels_regress
from tpgmm_core.model.frame_buffer import FrameBuffer


def without_time(frames: Mapping[str, Frame]) -> dict[str, Frame]:
    """The frames' maps of the data alone.

    Parameters
    ----------
    frames
        over [time, data], by name

    Returns
    -------
    dict[str, Frame]
        over the data, by name

    Raises
    ------
    ValueError
        for a frame that changes the first dimension or mixes it with others
    """
    return {name: _without_time(name, frame) for name, frame in frames.items()}


def require_time_kept(buffer: FrameBuffer) -> None:
    """Check that no frame changes time, like `without_time`, but fast enough for every change of the frames.

    Raises
    ------
    ValueError
        for a frame that changes the first dimension or mixes it with others
    """
    j = kernels_regress.time_changed(buffer.A, buffer.b, buffer.weights)
    if j >= 0:
        raise _time_changed(buffer.frame_names[j], buffer.A[j], buffer.b[j])


def check_time_kept(name: str, frame: Frame) -> None:
    """Check that a frame over [time, data] leaves time as it is.

    Parameters
    ----------
    name, frame
        of the frame

    Raises
    ------
    ValueError
        for a frame that changes the first dimension or mixes it with others
    """
    A, b = frame.A, frame.b
    size, columns = A.shape[-2:]
    is_mixed = A[..., 0, 1:].any() or A[..., 1:, 0].any()
    if min(size, columns) < 2 or is_mixed or (A[..., 0, 0] != 1.0).any() or b[..., 0].any():
        raise _time_changed(name, A, b)


def _without_time(name: str, frame: Frame) -> Frame:
    check_time_kept(name, frame)
    A, b = frame.A, frame.b
    inverse = None if frame.inverse is None else frame.inverse[..., 1:, 1:]
    return Frame(A[..., 1:, 1:], b[..., 1:], inverse, frame.pose_covariance)


def _time_changed(name: str, A: Array, b: Array) -> ValueError:
    return ValueError(
        f"frame {name!r} must leave the first dimension (time or decay) as it is, with A = blkdiag(1, ...) and "
        f"b = [0, ...]: make it by Frame.with_time(); got A {A.shape}, b {b.shape}"
    )
