# SPDX-License-Identifier: Apache-2.0
"""What is not known of a frame's pose, carried into what the frame says: one that is known badly counts less there."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold


def uncertain_precisions(
    name: str, means: Array, precisions: Array, frame: Frame, manifold: Manifold, uncertainty: ArrayLike
) -> Array:
    """Precisions of a frame's components when its own pose is uncertain, to first order.

    A frame that is displaced by d and turned by r about the fixed axes moves the point A mu + b by d + r x (R mu), and
    turns the orientation there by r. With J = [I, -[R mu]x; 0, I], which maps the pose's error to that of the
    component, the covariance in the common frame becomes A Sigma A^T + J P J^T; here it is given in the frame's axes.

    Parameters
    ----------
    name
        of the frame, for errors
    means, precisions
        of the model's components in the frame, (K, D) and (K, n, n)
    frame
        where the frame is, constant, a pose
    manifold
        of the data: [time, position], pose, or [time, pose]
    uncertainty
        P (6, 6), the covariance of the frame's pose: displacement and turn about the fixed axes, m² and rad², as in
        geometry_msgs/PoseWithCovariance

    Returns
    -------
    Array
        (K, n, n)

    Raises
    ------
    ValueError
        for a matrix that is no covariance (6, 6), and for data that are neither positions with time nor poses
    """
    P = np.asarray(uncertainty, dtype=float)
    is_covariance = P.shape == (6, 6) and bool(np.isfinite(P).all()) and np.allclose(P, P.T)
    if not is_covariance or np.linalg.eigvalsh(P)[0] < -1e-9 * np.trace(P):
        raise ValueError(
            f"the uncertainty of frame {shown(name)} is the covariance (6, 6) of its pose, finite, symmetric and with "
            f"no negative eigenvalue, m² and rad²; got shape {P.shape}: {shown(P.tolist())}"
        )
    n = manifold.tangent_dim
    has_turn = not manifold.is_euclidean
    if n not in ((6, 7) if has_turn else (4,)):
        raise ValueError(
            f"an uncertainty of frame {shown(name)} needs data [time, position], pose or [time, pose], got {manifold}"
        )
    p = n - (6 if has_turn else 3)  # where the position starts: after time, where there is one
    to_frame = np.linalg.pinv(frame.A if manifold.is_euclidean else manifold.tangent_map(frame.A))
    result = np.empty_like(precisions)
    for k, (mean, precision) in enumerate(zip(means, precisions, strict=True)):
        x, y, z = (frame.A @ mean)[p : p + 3]
        J = np.zeros((n, 6))
        J[p : p + 3, :3] = np.eye(3)
        J[p : p + 3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        if has_turn:
            J[p + 3 :, 3:] = np.eye(3)
        to_component = to_frame @ J
        # (Lambda^-1 + S)^-1 without an inverse of Lambda
        result[k] = np.linalg.solve(np.eye(n) + precision @ to_component @ P @ to_component.T, precision)
    return 0.5 * (result + np.swapaxes(result, 1, 2))
