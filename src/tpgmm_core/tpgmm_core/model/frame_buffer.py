# SPDX-License-Identifier: Apache-2.0
"""`FrameBuffer`: the frames of a moment, checked, and copied to where the kernels read them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.fitted import FittedModel, check_fitted
from tpgmm_core.model.kernels_uncertainty import position_start


class FrameBuffer:
    """Which frames of a model are known, how far each is trusted, and where the robot is.

    Parameters
    ----------
    model
        whose frames they are

    Attributes
    ----------
    manifold
        the space that the frames map to; on R^D it follows the frames
    sizes
        (P, 2), ambient and tangent dimensions D_j, n_j of the data that each frame sees
    A, b, weights
        (P, D, D_max), (P, D), (P,); a frame that is not known has the weight 0
    inverses, has_inverse
        (P, D_max, D), (P,); inverses that frames have in place of A^+, and which frames have one
    pose_covariances
        (P, 6, 6), how well the poses of the frames are known; 0: exactly
    state
        (D,), where the robot is; zeros (and no turn) where it is not known
    """

    manifold: Manifold
    A: Array
    b: Array
    inverses: Array
    has_inverse: NDArray[np.bool_]
    pose_covariances: Array
    weights: Array
    state: Array

    def __init__(self, model: FittedModel) -> None:
        check_fitted(model)
        self.frame_names = model.frame_names_
        manifolds = model.frame_manifolds_
        self.sizes: NDArray[np.int64] = np.array(
            [[manifolds[n].dim, manifolds[n].tangent_dim] for n in self.frame_names]
        )
        self._index = {name: j for j, name in enumerate(self.frame_names)}
        self._shape(model.manifold_)

    def _shape(self, manifold: Manifold) -> None:
        """Arrays for frames that map to this space."""
        P, D_max = len(self.sizes), int(self.sizes[:, 0].max())
        self.manifold = manifold
        self.A, self.b = np.zeros((P, manifold.dim, D_max)), np.zeros((P, manifold.dim))
        self._A_of = [A[:, :D_j] for A, (D_j, _) in zip(self.A, self.sizes, strict=True)]
        self._b_of = list(self.b)
        self.inverses, self.has_inverse = np.zeros((P, D_max, manifold.dim)), np.zeros(P, dtype=np.bool_)
        self._inverse_of = [M[:D_j] for M, (D_j, _) in zip(self.inverses, self.sizes, strict=True)]
        self.pose_covariances = np.zeros((P, 6, 6))
        self._has_more = False  # whether any frame of the last situation has an inverse or a covariance
        self.weights = np.zeros(P)
        self.state = self._origin = manifold_origin(manifold)

    @property
    def layout(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The manifold's arrangement as kernels take it: `flat` and `spheres`."""
        return self.manifold.ambient_of_tangent, self.manifold.sphere_starts

    def identity_frame(self) -> dict[str, Frame]:
        """One frame at the origin, which nothing contradicts: for a first step that only compiles."""
        D = self.manifold.dim
        return {self.frame_names[0]: Frame(np.eye(D, self.sizes[0, 0]), np.zeros(D))}

    def take(
        self, frames: Mapping[str, Frame], state: ArrayLike | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Copy the frames, weights and state of a situation into the arrays.

        Parameters
        ----------
        frames, state, weights
            as for `Adapter.adapt`

        Raises
        ------
        ValueError
            for unknown names, matrices and states that do not fit, time-varying frames, weights outside 0..1, and
            covariances of the frames' poses where the data are neither positions nor poses
        """
        if not frames:
            raise ValueError(f"a situation needs at least one of the frames {list(self.frame_names)}")
        self.weights.fill(0.0)
        if self._has_more:
            self.has_inverse.fill(False)
            self.pose_covariances.fill(0.0)
            self._has_more = False
        for name, frame in frames.items():
            j = self._index.get(name)
            if j is None:
                raise ValueError(f"unknown frame {name!r}; the model knows {list(self.frame_names)}")
            if frame.A.shape != self._A_of[j].shape:
                self._reshape(name, frame, j)
            self._A_of[j][...] = frame.A
            self._b_of[j][...] = frame.b
            if frame.inverse is not None:
                if not self.manifold.is_euclidean:
                    raise ValueError(
                        f"frame {name!r} has its own inverse, which only R^n permits, not {self.manifold}: leave it out"
                    )
                self._inverse_of[j][...] = frame.inverse
                self.has_inverse[j] = self._has_more = True
            if frame.pose_covariance is not None:
                self._require_pose(name)
                self.pose_covariances[j], self._has_more = frame.pose_covariance, True
            self.weights[j] = 1.0
        for name, weight in (weights or {}).items():
            if name not in self._index:
                raise ValueError(f"weights name the unknown frame {name!r}; the model knows {list(self.frame_names)}")
            if not 0.0 <= weight <= 1.0:
                raise ValueError(f"the weight of a frame is 0 to 1, {name!r} has {weight!r}")
            if name in frames:
                self.weights[self._index[name]] = weight
        self.state = self._origin
        if state is not None:
            where = np.array(state, dtype=float)
            if where.shape != self._origin.shape or not np.all(np.isfinite(where)):
                raise ValueError(f"the state has shape {self._origin.shape} and is finite, got {state!r}")
            self.state = where

    def _require_pose(self, name: str) -> None:
        layout = self.manifold.ambient_of_tangent, self.manifold.sphere_starts
        if position_start(*layout) < 0:
            raise ValueError(
                f"frame {name!r} has a covariance of its pose, which needs data [time, position], pose or "
                f"[time, pose], got {self.manifold}"
            )

    def _reshape(self, name: str, frame: Frame, j: int) -> None:
        """Make place for frames that map to another R^D than the former ones, or say why this one does not fit."""
        if frame.is_time_varying:
            raise ValueError(f"frame {name!r} varies with time: choose one time step with frame.at(t_index)")
        D, D_j = frame.A.shape
        if D_j != self.sizes[j, 0]:
            raise ValueError(f"frame {name!r} has A of {D_j} columns, the model has {self.sizes[j, 0]} dimensions")
        if not self.manifold.is_euclidean or self.weights.any():
            raise ValueError(f"frame {name!r} maps to {D} dimensions, the others to {self.manifold.dim}")
        self._shape(Manifold.euclidean(D))

    def frame(self, j: int) -> Frame:
        """Frame j as it was given last."""
        D_j = self.sizes[j, 0]
        inverse = self.inverses[j, :D_j] if self.has_inverse[j] else None
        covariance = self.pose_covariances[j] if self.pose_covariances[j].any() else None
        return Frame(self.A[j, :, :D_j], self.b[j], inverse, covariance)

    def refuse(self, j: int) -> None:
        """Raise the error that says why the matrix of a frame does not fit the manifold.

        Parameters
        ----------
        j
            index of the frame

        Raises
        ------
        ValueError
            always
        """
        self.manifold.tangent_map(self.A[j, :, : self.sizes[j, 0]])  # raises, and says why
        raise ValueError(f"frame {self.frame_names[j]!r} does not fit the manifold {self.manifold}")


def manifold_origin(manifold: Manifold) -> Array:
    """The point (D,) of zeros, and of no turn on S³."""
    origin = np.zeros(manifold.dim)
    for s in manifold.spheres:
        origin[s.ambient] = [0.0, 0.0, 0.0, 1.0]
    return origin
