# SPDX-License-Identifier: Apache-2.0
"""Frames that a constant transform would put right: a camera's transform that is inverted, or far off.

A camera that stands still and is placed wrongly moves all that it sees by one transform X of the base: no frame of it
sees demonstrations alike, but X times its poses do. One on the hand, placed wrongly, lets what rests move with it.
Both are the equation B = X A G of robot-world and hand-eye calibration (Shah 2013), with unknown constants X and G:

- fixed camera: A is the frame and B the hand, at one share of the time of all demonstrations; G is where the hand is
  in the frame;
- camera on the hand: A is the base in the hand and B the frame in the hand, at all times; G is where the frame rests,
  in each demonstration elsewhere.

Positions alone are used: B's are R_X (R_A t_G + t_A) + t_X. What is found has to foretell the demonstration that was
left out of the estimate. Nothing tells a wrong transform of a fixed camera where objects stand at the same place in all
demonstrations; there it does no harm before they stand elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration, evenly_chosen
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse

LEAST = 5
"""Demonstrations, of which each in turn is foretold by the others."""
MOST = 15
"""Demonstrations that are looked at, evenly chosen."""
SHARES, SAMPLES = 11, 20
"""Shares of the time at which demonstrations are compared; poses of one demonstration that are looked at."""
AGREE_M, APART_M, BETTER = 0.02, 0.03, 5.0
"""Demonstrations agree within the first; as given, they are apart by the second, and by so many times the rest."""
ITERATIONS = 30
GENERATORS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]], float
)


def doubts_of_cameras(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Frames that one constant transform would put right, of the base or of the hand.

    Parameters
    ----------
    shown
        demonstrations of one task

    Returns
    -------
    list[Doubt]
        one for each such frame; nothing is corrected
    """
    some = evenly_chosen(shown, MOST)
    found = []
    for name in shown[0].frames if len(some) >= LEAST else ():
        if all(name in one.frames and len(one.seen(name)) for one in some):
            text = _on_the_hand(some, name) or _at_rest(some, name)
            if text:
                found.append(Doubt("origin", (), text))
    return found


def _at_rest(some: Sequence[RawDemonstration], name: str) -> str:
    """What is wrong with a camera that stands still; empty: nothing is known to be."""
    samples = [np.linspace(0, len(one.times) - 1, SHARES).round().astype(int) for one in some]
    hand, place = (
        np.array([poses[at] for poses, at in zip(each, samples, strict=True)])
        for each in ([one.movement for one in some], [one.frames[name] for one in some])
    )
    seen = [one.visible.get(name, np.ones(len(one.times), bool))[at] for one, at in zip(some, samples, strict=True)]
    place[..., 3:] = quaternion.normalize(place[..., 3:])
    own = _spread(compose(inverse(place), hand)[..., :3])
    given = np.min([own, _spread(hand[..., :3] - place[..., :3]), _spread(hand[..., :3])], axis=0)
    if own.min() <= AGREE_M:
        return ""  # what it sees is seen alike, at some time
    group = np.zeros(len(some), np.intp)
    shares = np.flatnonzero(np.all(seen, axis=0) & (given > APART_M)).tolist()
    problems = {s: _Problem(place[:, s], hand[:, s, :3], group) for s in shares}
    rests = {s: problem.solution().rest for s, problem in problems.items()}
    s = min(shares, key=lambda s: rests[s] / given[s], default=0)
    if not shares or rests[s] > AGREE_M or given[s] < BETTER * problems[s].foretold():
        return ""
    return (
        f"the frame {name} and the movement seem to be in different base frames: seen from the frame, recordings "
        f"differ by {given[s]:.2g} m, and by {rests[s]:.2g} m if one constant transform of the base is applied to its "
        "poses. Is the transform from the base to its camera inverted, or that of another base? Nothing was "
        "changed; correct it, and record again"
    )


def _on_the_hand(some: Sequence[RawDemonstration], name: str) -> str:
    """What is wrong with a camera that moves with the hand; empty: nothing is known to be."""
    hands, places = [], []
    for one in some:
        poses = one.frames[name]
        fresh = np.flatnonzero(
            np.diff(poses, axis=0).any(axis=1) & one.visible.get(name, np.ones(len(poses), bool))[1:]
        )
        if len(fresh) < SAMPLES:
            return ""
        at = fresh[np.linspace(0, len(fresh) - 1, SAMPLES).round().astype(int)] + 1
        hands.append(one.movement[at])
        places.append(poses[at])
    hand, place = np.array(hands), np.array(places)
    for stop in (SAMPLES, SAMPLES // 2):  # it may be taken in the second half
        moves = float(np.median(_spread(np.swapaxes(place[:, :stop, :3], 0, 1))))
        if moves <= APART_M:
            continue
        A = inverse(hand[:, :stop]).reshape(-1, 7)
        B = np.asarray(compose(A, place[:, :stop].reshape(-1, 7)))[:, :3]
        problem = _Problem(A, B, np.repeat(np.arange(len(some)), stop))
        if (rest := problem.solution().rest) < min(AGREE_M, moves / BETTER):
            return (
                f"the frame {name} moves by {moves:.2g} m while the hand does, and would rest within {rest:.2g} m if "
                "one constant transform of the hand were applied to what is seen from there. Is the transform from the "
                "hand to its camera inverted, or far off? Nothing was changed; correct it, and record again"
            )
    return ""


def _spread(positions: Array) -> Array:
    """How far positions (M, S, 3) are from their mean, (S,) m."""
    return np.asarray(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=-1), axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """X as its inverse turn S (3, 3) and y = S t_X (3,), the places t_G (groups, 3), and the rest, m (rms)."""

    S: Array
    y: Array
    places: Array
    rest: float


class _Problem:
    """S B = R_A t_G + t_A + y, with S a rotation, for positions B (N, 3), poses A (N, 7) and numbers (N,) of G."""

    def __init__(self, A: Array, B: Array, group: NDArray[np.intp]) -> None:
        self.A, self.B, self.group = A, B, group
        self.R = quaternion.rotation_matrix(A[:, 3:])

    def solution(self, starts: Array | None = None) -> _Solution:
        """The best of those from several first turns (n, 3, 3): by Gauss-Newton, linear in all but the turn."""
        N, groups = len(self.B), int(self.group.max()) + 1
        blocks = np.zeros((N, 3, 3 + 3 * groups))
        blocks[:, :, :3] = np.eye(3)
        for axis in range(3):
            blocks[np.arange(N)[:, None], np.arange(3), 3 + 3 * self.group[:, None] + axis] = self.R[:, :, axis]
        D = blocks.reshape(3 * N, -1)
        M = np.einsum("ab,ic->iabc", np.eye(3), self.B).reshape(3 * N, 9)
        c = self.A[:, :3].ravel()
        U, scale, _ = np.linalg.svd(D, full_matrices=False)
        U = U[:, scale > 1e-6 * scale[0]]
        left, aim = M - U @ (U.T @ M), c - U @ (U.T @ c)
        H, b = left.T @ left, left.T @ aim
        S = np.array(_cube_turns() if starts is None else starts)
        for _ in range(ITERATIONS):
            J = (GENERATORS[None] @ S[:, None]).reshape(len(S), 3, 9)
            gradient = np.einsum("nka,na->nk", J, S.reshape(-1, 9) @ H - b)
            curvature = J @ H @ np.swapaxes(J, 1, 2)
            damping = 1e-9 + 1e-6 * np.trace(curvature, axis1=1, axis2=2)
            step = -np.linalg.solve(curvature + damping[:, None, None] * np.eye(3), gradient[..., None])[..., 0]
            S = quaternion.rotation_matrix(quaternion.exp(step)) @ S
        rests = np.sum((S.reshape(-1, 9) @ left.T - aim) ** 2, axis=1)
        best = S[int(np.argmin(rests))]
        theta = np.linalg.lstsq(D, M @ best.ravel() - c, rcond=1e-6)[0]
        return _Solution(best, theta[:3], theta[3:].reshape(-1, 3), float(np.sqrt(rests.min() / N)))

    def foretold(self) -> float:
        """How far each B is from what the others foretell, m (rms); all of one G."""
        first, errors = self.solution(), []
        for i in range(len(self.B)):
            others = np.arange(len(self.B)) != i
            found = _Problem(self.A[others], self.B[others], self.group[others]).solution(first.S[None])
            b = found.S.T @ (self.R[i] @ found.places[0] + self.A[i, :3] + found.y)
            errors.append(np.sum((b - self.B[i]) ** 2))
        return float(np.sqrt(np.mean(errors)))


def _cube_turns() -> list[Array]:
    """The 24 rotations of a cube."""
    turns = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [turn for turn in turns if np.linalg.det(turn) > 0.0]
