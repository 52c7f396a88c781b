# SPDX-License-Identifier: Apache-2.0
"""The planar data of pbdlib, the paper's own library, as demonstrations, and frames between and beyond theirs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.linalg import polar

from tpgmm_core import Demonstration, Frame

DATA = Path("../shared/data/pbdlib")


def demonstrations(directory: Path) -> list[Demonstration]:
    """Data02.mat: four movements of 200 samples, [time in s, x, y], with two frames.

    The second one is a reflection. The file's own views agree with Eq. (4) to its rounding.

    Raises FileNotFoundError when the data are not there.
    """
    path = directory / "Data02.mat"
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing: give the directory of pbdlib's Data02.mat by --data")
    result = []
    for one in loadmat(path, simplify_cells=True)["s"]:
        data = np.asarray(one["Data0"], dtype=float).T
        frames = {name: Frame(p["A"], p["b"]) for name, p in zip(("first", "second"), one["p"], strict=True)}
        result.append(Demonstration(data[:, 0], data, frames))
    return result


def between(start: Frame, end: Frame, fraction: float) -> Frame:
    """The frame (over [time, x, y]) at a fraction of the way from one to another; below 0 and above 1 beyond them.

    A = Q S splits into what turns, and may reflect, and what stretches (polar decomposition). The turn from one Q to
    the other goes by its angle; S and b go in straight lines. Raises ValueError when only one of the frames reflects.
    """
    (Q, S), (R, T) = polar(start.A[1:, 1:]), polar(end.A[1:, 1:])
    turn = R @ Q.T
    if np.linalg.det(turn) < 0.0:
        raise ValueError("one of the frames is a reflection and the other is not: no turn leads from one to the other")
    angle = fraction * np.arctan2(turn[1, 0], turn[0, 0])
    c, s = np.cos(angle), np.sin(angle)
    A = np.array([[c, -s], [s, c]]) @ Q @ (S + fraction * (T - S))
    return Frame(A, start.b[1:] + fraction * (end.b - start.b)[1:]).with_time()
