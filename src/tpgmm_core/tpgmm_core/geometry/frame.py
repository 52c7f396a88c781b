# SPDX-License-Identifier: Apache-2.0
"""`Frame`: one affine map xi = A x + b of an observer, or one per time step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.constants import ORTHOGONAL, RANK_TOLERANCE
from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Task parameters of one frame: xi = A x + b.

    When only one of A and b varies with time, the constant one is repeated. A frame is a value: it keeps read-only
    copies, and two frames are equal when their numbers are.

    Parameters
    ----------
    A
        shape (D, D_j), or (T, D, D_j) when it changes with time; any matrix
    b
        shape (D,), or (T, D)
    inverse
        shape (D_j, D), or (T, D_j, D) as A: how the frame sees xi - b, where that is not A^+. A damped A (near
        singularities) has no bounded pseudo-inverse that is continuous, so it comes with the inverse that is meant
    pose_covariance
        shape (6, 6), how well the pose of a constant frame is known: displacement and turn about the fixed axes, m²,
        m rad and rad², as in geometry_msgs/PoseWithCovariance; None: exactly

    Raises
    ------
    ValueError
        for shapes that do not fit, for non-finite numbers, and for what is no covariance
    """

    A: Array
    b: Array
    inverse: Array | None = None
    pose_covariance: Array | None = None

    def __post_init__(self) -> None:
        A, b = np.array(self.A, dtype=float), np.array(self.b, dtype=float)
        if A.ndim not in (2, 3) or b.ndim not in (1, 2) or A.shape[-2] != b.shape[-1] or 0 in A.shape:
            raise ValueError(f"a frame has A (D, D_j) or (T, D, D_j) and b (D,) or (T, D), got {A.shape} and {b.shape}")
        if A.ndim == 3 or b.ndim == 2:
            steps = len(A) if A.ndim == 3 else len(b)
            if (A.ndim == 3 and b.ndim == 2) and len(b) != steps:
                raise ValueError(f"A has {len(A)} time steps, b has {len(b)}")
            A = np.broadcast_to(A, (steps, *A.shape[-2:]))
            b = np.broadcast_to(b, (steps, b.shape[-1]))
        if not (np.isfinite(A).all() and np.isfinite(b).all()):
            raise ValueError("the A and b of a frame must be finite")
        if self.inverse is not None:
            inverse = np.array(self.inverse, dtype=float)
            transposed = A.shape[:-2] + A.shape[:-3:-1]
            if inverse.shape not in (transposed, transposed[-2:]) or not np.isfinite(inverse).all():
                raise ValueError(
                    f"the inverse of A {A.shape} is finite and has the transposed shape, got {inverse.shape}"
                )
            object.__setattr__(
                self, "inverse", inverse if inverse.shape == transposed else np.broadcast_to(inverse, transposed)
            )
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "b", b)
        if self.pose_covariance is not None:
            object.__setattr__(self, "pose_covariance", _checked_covariance(self.pose_covariance, A.ndim == 3))

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if not isinstance(other, Frame):
            return NotImplemented
        return (
            _are_equal(self.b, other.b)
            and _are_equal(self.A, other.A)
            and _are_equal(self.inverse, other.inverse)
            and _are_equal(self.pose_covariance, other.pose_covariance)
        )

    def __hash__(self) -> int:
        return hash((self.A.shape, (self.A + 0.0).tobytes(), (self.b + 0.0).tobytes()))  # -0 becomes 0, its equal

    @classmethod
    def _owning(cls, A: Array, b: Array) -> Frame:
        """Frame of arrays (T, D, D_j) and (T, D) that were made for it: without copies, which may be large."""
        if not (np.all(np.isfinite(A)) and np.all(np.isfinite(b))):
            raise ValueError("the A and b of a frame must be finite")
        frame = object.__new__(cls)
        values = {"A": np.broadcast_to(A, A.shape), "b": np.broadcast_to(b, b.shape)}
        for name in ("A", "b", "inverse", "pose_covariance"):
            object.__setattr__(frame, name, values.get(name))
        return frame

    @classmethod
    def _made(cls, A: Array, b: Array) -> Frame:
        """Frame of arrays (D, D_j) and (D,) that a kernel has just made of a frame: in a loop, checks take long."""
        frame = object.__new__(cls)
        for setter, value in zip(SETTERS, (A, b, None, None), strict=True):
            setter(frame, value)
        return frame

    @classmethod
    def from_pose(
        cls,
        position: ArrayLike,
        orientation: ArrayLike,
        pose_covariance: ArrayLike | None = None,
        stretch: ArrayLike | None = None,
    ) -> Frame:
        """Frame of an object, for poses [x, y, z, qx, qy, qz, qw].

        A = blkdiag(R S, L(q)) and b = [position, 0]; the quaternion is normalised.

        Parameters
        ----------
        position
            of the object, (3,) or (T, 3), m
        orientation
            of the object, quaternion x, y, z, w, (4,) or (T, 4)
        pose_covariance
            (6, 6), how well they are known, see `Frame`; None: exactly
        stretch
            S, (3, 3) or (T, 3, 3), what the object's axes do to positions, such as a scaling by its size; None: nothing

        Returns
        -------
        Frame
            constant for one pose, varying with time for T poses

        Raises
        ------
        ValueError
            for shapes that do not fit, for zero or non-finite quaternions, and for what is no covariance
        """
        position, orientation = np.asarray(position, dtype=float), quaternion.normalize(orientation)
        if position.shape[-1:] != (3,) or orientation.shape[-1:] != (4,):
            raise ValueError(
                f"a pose has a position (3,) and a quaternion (4,), got {position.shape}, {orientation.shape}"
            )
        steps = np.broadcast_shapes(position.shape[:-1], orientation.shape[:-1])
        A = np.zeros((*steps, 7, 7))
        R = quaternion.rotation_matrix(orientation)
        A[..., :3, :3] = R if stretch is None else R @ np.asarray(stretch, dtype=float)
        A[..., 3:, 3:] = quaternion.left_matrix(orientation)
        b = np.zeros((*steps, 7))
        b[..., :3] = position
        if steps and pose_covariance is None:
            return cls._owning(A, b)
        return cls(A, b, pose_covariance=None if pose_covariance is None else np.asarray(pose_covariance, dtype=float))

    @classmethod
    def stacked(cls, frames: Sequence[Frame]) -> Frame:
        """One frame for data that lie side by side, each seen from its own frame: A = blkdiag(A_1, A_2, ...).

        It counts as known exactly.

        For two hands, poses [left, right] on "R3 x S3 x R3 x S3", and an object that both are seen from:
        `Frame.stacked([pose, pose])` with `pose = Frame.from_pose(...)`.

        Parameters
        ----------
        frames
            one for each part of the data, in order; those that vary with time have the same number of time steps

        Returns
        -------
        Frame
            the frame of the data side by side

        Raises
        ------
        ValueError
            for no frames, and for frames of different numbers of time steps
        """
        steps = {len(frame.A) for frame in frames if frame.is_time_varying}
        if not frames or len(steps) > 1:
            raise ValueError(f"frames to be stacked are one or more, of the same time steps, got {sorted(steps)}")
        inverse = None
        if any(frame.inverse is not None for frame in frames):
            inverse = block_diagonal(*(frame.pseudo_inverse() for frame in frames))
        b = [np.broadcast_to(frame.b, (*steps, frame.b.shape[-1])) for frame in frames]
        return cls(block_diagonal(*(frame.A for frame in frames)), np.concatenate(b, axis=-1), inverse)

    def with_time(self) -> Frame:
        """The same frame for data whose first dimension is time: A = blkdiag(1, A), b = [0, b]."""
        one = np.ones((1, 1))
        A, inverse = (None if M is None else block_diagonal(one, M) for M in (self.A, self.inverse))
        assert A is not None
        b = np.concatenate([np.zeros((*self.b.shape[:-1], 1)), self.b], axis=-1)
        if self.is_time_varying and inverse is None and self.pose_covariance is None:
            return Frame._owning(A, b)
        return Frame(A, b, inverse, self.pose_covariance)

    @property
    def is_time_varying(self) -> bool:
        """Whether A and b hold one map per time step."""
        return self.A.ndim == 3

    def at(self, t_index: int | NDArray[np.intp]) -> Frame:
        """The map at one time step, or at several; a constant frame is the same at all of them.

        Parameters
        ----------
        t_index
            one index, or an array of them

        Returns
        -------
        Frame
            a constant frame for one index, one that varies with time for an array
        """
        if not self.is_time_varying:
            return self
        return Frame(self.A[t_index], self.b[t_index], None if self.inverse is None else self.inverse[t_index])

    def project(self, xi: ArrayLike) -> Array:
        """Data as seen from the frame: x = A^+ (xi - b), Eq. (4).

        `inverse` is used in place of A^+ where it is given. The pseudo-inverse serves any A; for a pose frame it is the
        exact inverse, since L(q)^-1 = L(q)^T.

        Parameters
        ----------
        xi
            data in the common frame, (D,) or (T, D)

        Returns
        -------
        Array
            (D_j,) or (T, D_j)

        Raises
        ------
        ValueError
            for data whose shape does not fit
        """
        xi = np.asarray(xi, dtype=float)
        if xi.ndim not in (1, 2) or xi.shape[-1] != self.b.shape[-1]:
            raise ValueError(f"data for this frame has shape (T, {self.b.shape[-1]}), got {xi.shape}")
        if self.is_time_varying and xi.ndim == 2 and len(xi) != len(self.A):
            raise ValueError(f"the frame has {len(self.A)} time steps, the data {len(xi)}")
        return np.einsum("...ij,...j->...i", self.pseudo_inverse(), xi - self.b)

    def pseudo_inverse(self) -> Array:
        """Compute A^+, or take `inverse` where the frame has one of its own.

        A^T where A^T A = I to rounding, as in pose frames: singular values of each sample of a frame that moves would
        take most of the time of learning.

        Returns
        -------
        Array
            (..., D_j, D)
        """
        if self.inverse is not None:
            return self.inverse
        transposed = self.A.swapaxes(-1, -2)
        n = self.A.shape[-1]
        if self.A.shape[-2] == n and np.abs(transposed @ self.A - np.eye(n)).max(initial=0.0) < ORTHOGONAL:
            return transposed
        return np.linalg.pinv(self.A, rcond=RANK_TOLERANCE)


# of the fields, which a frozen class does not offer
SETTERS = [vars(Frame)[name].__set__ for name in ("A", "b", "inverse", "pose_covariance")]


def is_pose_covariance(P: Array) -> bool:
    """Whether these numbers are a covariance (6, 6): finite, symmetric, with no negative eigenvalue beyond rounding."""
    is_symmetric = P.shape == (6, 6) and bool(np.isfinite(P).all()) and np.allclose(P, P.T)
    return is_symmetric and bool(np.linalg.eigvalsh(P)[0] >= -1e-9 * np.trace(P))


def _checked_covariance(covariance: ArrayLike, is_time_varying: bool) -> Array:
    P = np.array(covariance, dtype=float)
    if is_time_varying or not is_pose_covariance(P):
        raise ValueError(
            f"a constant frame may have the covariance (6, 6) of its pose, finite, symmetric and with no negative "
            f"eigenvalue, m² and rad²; got shape {P.shape}: {shown(P.tolist())}"
        )
    return P


def _are_equal(one: Array | None, other: Array | None) -> bool:
    """Whether shapes and numbers are the same. Comparing bytes is five times as fast where nothing has changed."""
    if one is None or other is None:
        return one is other
    return one.shape == other.shape and (one.tobytes() == other.tobytes() or np.array_equal(one, other))


def block_diagonal(*blocks: Array) -> Array:
    """Put matrices (..., rows, columns) along the diagonal of one matrix; leading axes broadcast."""
    rows, columns = sum(block.shape[-2] for block in blocks), sum(block.shape[-1] for block in blocks)
    result = np.zeros((*np.broadcast_shapes(*(block.shape[:-2] for block in blocks)), rows, columns))
    i = j = 0
    for block in blocks:
        result[..., i : i + block.shape[-2], j : j + block.shape[-1]] = block
        i, j = i + block.shape[-2], j + block.shape[-1]
    return result
