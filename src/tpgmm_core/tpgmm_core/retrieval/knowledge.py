# SPDX-License-Identifier: Apache-2.0
"""How well a reference is known, beside how well the complete task knows it: the direction in which too little is left.

The product of Eq. (6) has a mean in every direction, also where the frames that are left say next to nothing of it.
Whether that is too little, no covariance tells alone: a task may leave a direction free. Hence a covariance S is held
against the covariance C of the same moment with all frames. The generalised eigenvectors, S v = r^2 C v, are the
directions in which the standard deviation has grown by r. A direction is unknown where r is above a ratio and the
standard deviation itself above a limit. Positions and each orientation are judged by themselves, in their own units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from tpgmm_core.common.settings import check_settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE

_AXES = "x", "y", "z"
_ALONG_AXIS = 0.95
"""A direction is called by an axis where its component is at least this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnowledgeConfig:
    """From when on too little is known to go on."""

    unknown_ratio: float = setting(
        10.0,
        0.0,
        1.0e6,
        "A movement waits if missing frames make the reference's standard deviation larger by more than this factor, "
        "and larger than unknown_position or unknown_orientation; 0: it never waits",
    )
    unknown_position: float = setting(
        0.03, 1e-4, 100.0, "Standard deviation of the position up to which a movement never waits, m"
    )
    unknown_orientation: float = setting(
        0.175, 1e-3, 100.0, "The same for an orientation or a joint, rad (prismatic joint: m)"
    )

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of its range."""
        check_settings(self)


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known in one direction, now and with all frames.

    Parameters
    ----------
    kind
        what the direction is of: "position", "orientation" or "joints"
    direction
        (n,), of length 1, along or about the fixed axes
    present, complete
        standard deviation in this direction, m or rad: of what is known now, and with all frames
    excess
        above 1: too little is known. The smaller one of the ratio and the deviation, each over what is allowed
    """

    kind: str
    direction: Array
    present: float
    complete: float
    excess: float

    def words(self) -> tuple[str, str]:
        """How well the reference is known and in which direction, then how well with all frames; for people."""
        there = f"{'about' if self.kind == 'orientation' else 'along'} {self._direction()}"
        if self.present > 0.5 * math.sqrt(UNCONSTRAINED_VARIANCE):
            return f"not at all {there}", self._amount(self.complete)
        return f"to {self._amount(self.present)} {there}", self._amount(self.complete)

    def _amount(self, deviation: float) -> str:
        if self.kind == "joints":
            return f"{deviation:.2g} rad or m"
        number, unit = (1e3 * deviation, "mm") if self.kind == "position" else (math.degrees(deviation), "deg")
        return f"{number:.0f} {unit}" if number >= 10.0 else f"{number:.2g} {unit}"

    def _direction(self) -> str:
        i = int(np.argmax(np.abs(self.direction)))
        if abs(self.direction[i]) >= _ALONG_AXIS:
            return f"joint {i + 1}" if self.kind == "joints" else _AXES[i]
        return f"({', '.join(f'{c:.2f}' for c in self.direction)})"


def least_known(complete: Array, present: Array, manifold: Manifold, config: KnowledgeConfig) -> Knowledge:
    """The direction in which too little is known, or comes nearest to it.

    Parameters
    ----------
    complete
        (n, n), positive definite: covariance of the reference with all frames
    present
        (n, n), of what is known now, at the same moment
    manifold
        of the reference: poses, or joints on R^n
    config
        the limits; its ratio is above 0

    Returns
    -------
    Knowledge
        the one with the largest excess

    Raises
    ------
    ValueError
        for covariances of another size, or that are not positive definite
    """
    n = manifold.tangent_dim
    if complete.shape != (n, n) or present.shape != (n, n):
        raise ValueError(
            f"covariances on {manifold} have shape {(n, n)}, got {complete.shape} (complete) and {present.shape}"
        )
    found = []
    for kind, where in _parts(manifold):
        limit = config.unknown_position if kind == "position" else config.unknown_orientation
        C, S = complete[np.ix_(where, where)], present[np.ix_(where, where)]
        try:
            directions = eigh(S, C)[1]
        except np.linalg.LinAlgError as error:
            raise ValueError(f"the covariance of the {kind} with all frames is not positive definite") from error
        for direction in (directions / np.linalg.norm(directions, axis=0)).T:
            now, then = (math.sqrt(max(float(direction @ one @ direction), 0.0)) for one in (S, C))
            excess = min(now / (config.unknown_ratio * then), now / limit)
            found.append(Knowledge(kind, direction, now, then, excess))
    return max(found, key=lambda one: one.excess)


def _parts(manifold: Manifold) -> list[tuple[str, NDArray[np.intp]]]:
    """What is judged by itself, and its tangent dimensions."""
    if manifold.is_euclidean:
        return [("joints", np.arange(manifold.tangent_dim))]
    turns = [("orientation", np.arange(manifold.tangent_dim)[s.tangent]) for s in manifold.spheres]
    places = manifold.flat_tangent
    return [("position", places), *turns] if len(places) else turns
