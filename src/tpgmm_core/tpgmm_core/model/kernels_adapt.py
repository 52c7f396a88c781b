# SPDX-License-Identifier: Apache-2.0
"""Adapting all components to new frames (Eqs. 5, 6), compiled.

Numbers that are worked on for all components together lie side by side, component last, so that the innermost loops
vectorise. Frame j takes `sizes[j]` = (D_j, n_j) ambient and tangent dimensions to D and n.
`flat[i]` is the ambient index of tangent dimension i, or -1 on S³, and `spheres[s]` = (first ambient, first tangent
index) of each S³ factor: `Manifold.ambient_of_tangent` and `Manifold.sphere_starts`.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.constants import RANK_TOLERANCE
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, copy_rows, inlined, invert_side_by_side, is_orthogonal, pseudo_inverse
from tpgmm_core.geometry.kernels_product import fuse
from tpgmm_core.geometry.kernels_rotation import rotation_of_left_matrix
from tpgmm_core.geometry.kernels_terms import invert_precision, scratch_for
from tpgmm_core.model.kernels_uncertainty import is_uncertain, lessen


@compiled
def tangent_matrix(A: Array, flat: Array, spheres: Array, out: Array) -> bool:
    """How a matrix A acts on tangent vectors.

    Parameters
    ----------
    A
        (D, D_j)
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    out
        (n, n_j), written

    Returns
    -------
    bool
        False when a block on S³ is not L(q)
    """
    if len(spheres) == 0:
        copy_rows(A, out)
        return True
    n = len(flat)
    for i in range(n):
        for m in range(n):
            out[i, m] = A[flat[i], flat[m]] if flat[i] >= 0 and flat[m] >= 0 else 0.0
    for s in range(len(spheres)):
        a, t = spheres[s]
        for i in range(A.shape[0]):
            if i < a or i >= a + 4:
                for m in range(a, a + 4):
                    if A[i, m] != 0.0 or A[m, i] != 0.0:
                        return False
        if not rotation_of_left_matrix(A[a : a + 4, a : a + 4], out[t : t + 3, t : t + 3]):
            return False
    return True


@compiled
def multiply(F: Array, rows: Array, width: int, out: Array) -> None:
    """out[o, c] = sum over i of F[o, i] rows[i, c], for c < width.

    Parameters
    ----------
    F
        (o, i)
    rows
        (i, width or more)
    width
        how many columns
    out
        (o, width or more), written
    """
    n, count = F.shape
    for o in range(n):
        for c in range(width):
            out[o, c] = 0.0
        # four rows at once, since the rows are short; beyond the last one the factor is zero
        for i in range(0, count, 4):
            i1, i2, i3 = min(i + 1, count - 1), min(i + 2, count - 1), min(i + 3, count - 1)
            f0 = F[o, i]
            f1 = F[o, i1] if i + 1 < count else 0.0
            f2 = F[o, i2] if i + 2 < count else 0.0
            f3 = F[o, i3] if i + 3 < count else 0.0
            if f0 != 0.0 or f1 != 0.0 or f2 != 0.0 or f3 != 0.0:  # frames are full of zeros
                for c in range(width):
                    out[o, c] += f0 * rows[i, c] + f1 * rows[i1, c] + f2 * rows[i2, c] + f3 * rows[i3, c]


@inlined
def view_frame(
    means: Array, precisions: Array, size: Array, flat: Array, spheres: Array, A: Array, b: Array, inverse: Array,
    has_inverse: bool, weight: float, half: Array, turned: Array, targets: Array, terms: Array,
) -> bool:  # fmt: skip
    """Eq. (5) for one frame and all components.

    Parameters
    ----------
    means
        (D_j, K), of the model
    precisions
        (n_j, n_j K), of the model
    size
        D_j and n_j
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    A, b
        the frame, (D, D_j) and (D,)
    inverse
        (D_j, D), the frame's own one; used where has_inverse
    has_inverse
        whether the frame has its own inverse
    weight
        how far the frame is trusted, 0 to 1
    half, turned
        (n, n_j K) and (n_j, n K), scratch
    targets
        (D, K), written: A mu + b
    terms
        (n, n K), written: weight M^T Lambda_k M with M = A^+, or the frame's inverse

    Returns
    -------
    bool
        False when A does not fit the manifold
    """
    D, K = targets.shape
    D_j, n_j = size
    n = len(flat)
    tangent, own = np.empty((n, n_j)), np.empty((D, D_j))
    copy_rows(A[:D, :D_j], own)
    if not tangent_matrix(own, flat, spheres, tangent):
        return False
    M = tangent
    if has_inverse or not (n == n_j and is_orthogonal(tangent)):  # of a rotation, A^+ = A^T
        of_frame = inverse if has_inverse else pseudo_inverse(tangent, RANK_TOLERANCE)
        M = np.empty((n, n_j))
        for i in range(n):
            for m in range(n_j):
                M[i, m] = of_frame[m, i]
    multiply(M, precisions, n_j * K, half)
    for i in range(n):
        for m in range(n_j):
            for k in range(K):
                turned[m, i * K + k] = weight * half[i, m * K + k]
    multiply(M, turned, n * K, terms)
    multiply(own, means, K, targets)
    for i in range(D):
        for k in range(K):
            targets[i, k] += b[i]
    return True


@compiled
def adapt(
    means: Array, precisions: Array, sizes: Array, flat: Array, spheres: Array, A: Array, b: Array, inverses: Array,
    has_inverse: Array, pose_covariances: Array, weights: Array, state: Array, min_precision: float, out_means: Array,
    out_covariances: Array,
) -> int:  # fmt: skip
    """Eqs. (5) and (6) for all components.

    Parameters
    ----------
    means
        (P, D_max, K)
    precisions
        (P, n_max, n_max K); entry (l, m) of component k lies at [l, m K + k]
    sizes
        (P, 2), ambient and tangent dimensions of each frame
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    A, b
        of the frames, (P, D, D_max) and (P, D)
    inverses, has_inverse
        (P, D_max, D) and (P,)
    pose_covariances
        (P, 6, 6), how well the poses of the frames are known; 0: exactly
    weights
        (P,), how far each frame is trusted
    state
        (D,), where directions that no frame constrains stay
    min_precision
        smallest eigenvalue of a component's precision
    out_means, out_covariances
        (K, D) and (K, n, n), written

    Returns
    -------
    int
        -1, or the frame whose matrix does not fit S³, or -2 - k for the component whose product did not converge
    """
    P, K = means.shape[0], means.shape[2]
    D, n = len(state), len(flat)
    half, turned = np.empty((n, precisions.shape[2])), np.empty((precisions.shape[1], n * K))
    targets, terms = np.empty((P, D, K)), np.empty((P, n, n * K))
    for j in range(P):
        if not weights[j] > 0.0:
            continue
        if not view_frame(
            means[j], precisions[j], sizes[j], flat, spheres, A[j], b[j], inverses[j], has_inverse[j],
            weights[j], half, turned, targets[j], terms[j],
        ):  # fmt: skip
            return j
        if is_uncertain(pose_covariances[j]):
            lessen(pose_covariances[j], weights[j], targets[j], b[j], flat, spheres, terms[j])
    if len(spheres) == 0:
        add_up(weights, targets, terms, state, min_precision, flat, spheres, out_means, out_covariances)
        return -1
    component_targets, component_terms = np.empty((P, D)), np.empty((P, n, n))
    for k in range(K):
        for j in range(P):
            for i in range(D):
                component_targets[j, i] = targets[j, i, k]
            for o in range(n):
                for i in range(o, n):
                    component_terms[j, i, o] = terms[j, o, i * K + k]
        if not fuse(
            component_targets, component_terms, weights, state, min_precision, flat, spheres,
            out_means[k], out_covariances[k],
        ):  # fmt: skip
            return -2 - k
    return -1


@inlined
def add_up(
    weights: Array, targets: Array, terms: Array, state: Array, min_precision: float, flat: Array, spheres: Array,
    out_means: Array, out_covariances: Array,
) -> None:  # fmt: skip
    """Eq. (6) on R^n, for all components at once: precisions add up, means are weighted by them.

    Sums are taken about one frame's means, so that a world far from its origin costs no digits.

    Parameters
    ----------
    weights
        (P,)
    targets, terms
        (P, n, K) and (P, n, n K), as `view_frame` writes them
    state
        (D,), where directions that no frame constrains stay
    min_precision
        smallest eigenvalue of a component's precision
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    out_means, out_covariances
        (K, D) and (K, n, n), written
    """
    P, n, K = targets.shape
    H, pulls, d = np.zeros((n, n * K)), np.zeros((n, n * K)), np.zeros(n * K)
    base, pull = np.empty((n, K)), np.zeros((n, K))
    for i in range(n):
        for k in range(K):
            base[i, k] = state[i]
    is_first = True
    for j in range(P):
        if not weights[j] > 0.0:
            continue
        if is_first:
            copy_rows(targets[j], base)
            is_first = False
        for i in range(n):
            for k in range(K):
                d[i * K + k] = targets[j, i, k] - base[i, k]
        for o in range(n):
            for c in range(n * K):
                H[o, c] += terms[j, o, c]
                pulls[o, c] += terms[j, o, c] * d[c]
    for o in range(n):
        for i in range(n):
            for k in range(K):
                pull[o, k] += pulls[o, i * K + k]
    invert_side_by_side(H.reshape(n, n, K), pulls.reshape(n, n, K), out_covariances)
    for k in range(K):
        trace = 0.0
        for o in range(n):
            trace += out_covariances[k, o, o]
            out_means[k, o] = base[o, k]
        if not trace * min_precision < 1.0:  # maybe an eigenvalue of H below min_precision
            precision, gradient = np.empty((n, n)), np.empty(n)
            for i in range(n):
                gradient[i] = -pull[i, k]
                for m in range(n):
                    precision[i, m] = H[i, m * K + k]
            invert_precision(
                precision, gradient, out_means[k], state, min_precision, flat, spheres, scratch_for(n),
                out_covariances[k],
            )  # fmt: skip
            for i in range(n):
                pull[i, k] = -gradient[i]
        for i in range(n):
            for m in range(n):
                out_means[k, i] += out_covariances[k, i, m] * pull[m, k]
