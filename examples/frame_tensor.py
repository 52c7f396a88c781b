# SPDX-License-Identifier: Apache-2.0
"""Demonstrations seen from all frames as one tensor (Section 7): eigenframes, eigenposes, eigentrajectories.

Frames x demonstrations x time x position: what each frame sees, less its mean over the demonstrations. A Tucker
decomposition says how many directions of each kind there are. A frame that sees what another one sees, but for a fixed
displacement and turn, is redundant: its view is a linear function of the other one's, also in a demonstration that took
no part in finding the function. Last, a model (a Gaussian per time step and frame) is compressed by such a
decomposition, and reproduces demonstrations that were left out.

The decomposition is TensorLy's, which only this program needs: pip install tensorly
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from examples.claims import at_least, at_most, canvas, finish, options_of  # noqa: E402
from examples.report import progress  # noqa: E402
from tpgmm_core import Demonstration, Frame  # noqa: E402
from tpgmm_core.choice.automatic import POSITIONS, positions_alone  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce  # noqa: E402
from tpgmm_core.choice.trial import SAMPLES, thinned  # noqa: E402
from tpgmm_core.common.report import Row, format_table  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.learning.learned_mixture import LearnedMixture  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.recordings.bags import find_bags, read_demonstrations  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

SAME = 0.99
"""A frame is redundant where another one explains this share of what it sees."""
KEPT = (0.9, 0.99, 0.999)
"""Shares of the model's tensor, by squares, that are kept."""
MODES = ("eigenframes", "situations", "eigentrajectories", "eigenposes")
TWIN = " (twin)"


def views(shown: Sequence[Demonstration]) -> Array:
    """What each frame sees at the same shares of the time, (P, M, T, D), m; data are over [time, position]."""
    return np.stack([[d.frames[name].project(d.data)[:, 1:] for d in shown] for name in shown[0].frames])


def with_twin(shown: Demonstration, name: str) -> Demonstration:
    """The same with a frame that is fixed to another one, elsewhere on it and turned by a quarter."""
    twin = np.eye(4)
    twin[1:3, 1:3] = [[0.0, -1.0], [1.0, 0.0]]
    frame = shown.frames[name]
    there = Frame(frame.A @ twin, frame.b + frame.A @ [0.0, 0.1, 0.05, 0.2])
    return replace(shown, frames={**shown.frames, name + TWIN: there})


def explained(seen: Array) -> Array:
    """Share of what a frame (second axis) sees that another one (first axis) explains, demonstrations left out: (P, P).

    Each demonstration's deviation from the mean of the others is predicted by the linear map that is best for those.
    """
    P, M, _, D = seen.shape
    left, total = np.zeros((P, P)), np.zeros(P)
    for m in range(M):
        others = np.delete(seen, m, axis=1)
        mean = others.mean(axis=1)
        learned = (others - mean[:, None]).reshape(P, -1, D)
        asked = seen[:, m] - mean
        total += np.sum(asked**2, axis=(1, 2))
        for i in range(P):
            maps = np.linalg.lstsq(learned[i], np.concatenate(learned, axis=1), rcond=None)[0]
            rest = np.concatenate(asked, axis=1) - asked[i] @ maps
            left[i] += np.sum(rest.reshape(len(rest), P, D) ** 2, axis=(0, 2))
    return np.asarray(np.clip(1.0 - left / np.maximum(total, 1e-12), 0.0, 1.0))


def redundant(names: Sequence[str], shares: Array) -> dict[str, str]:
    """Frames that can be had from one that stands before them: name → that one's."""
    found: dict[str, str] = {}
    for j, name in enumerate(names):
        same = [i for i in range(j) if names[i] not in found and min(shares[i, j], shares[j, i]) >= SAME]
        if same:
            found[name] = names[max(same, key=lambda i: shares[i, j])]
    return found


def decomposed(tensor: Array, ranks: Sequence[int]) -> tuple[Array, list[Array]]:
    """The core and the factors (one for each axis) of a Tucker decomposition."""
    from tensorly.decomposition import tucker

    ranks = [min(rank, tensor.size // size) for rank, size in zip(ranks, tensor.shape, strict=True)]
    core, factors = tucker(tensor, rank=ranks, init="svd", n_iter_max=50, tol=1e-8)
    return np.asarray(core), [np.asarray(factor) for factor in factors]


def energies(core: Array) -> list[Array]:
    """Along each axis of a core: the share of each of its slices, by squares, largest first."""
    total = np.sum(core**2)
    return [np.sort(np.sum(core**2, axis=tuple(set(range(core.ndim)) - {k})))[::-1] / total for k in range(core.ndim)]


def needed(shares: Array, kept: float) -> int:
    """How many of the largest shares add up to what is to be kept."""
    return min(int(np.searchsorted(np.cumsum(shares), kept * (1.0 - 1e-12))) + 1, len(shares))


def compressed(model: LearnedMixture, kept: float) -> tuple[LearnedMixture, int, int]:
    """A model of time steps from fewer numbers; how many these are, and how many they were.

    The tensor is frames x steps x numbers of a Gaussian: its mean, and the logarithm of its covariance, so that what
    comes back is a covariance, too.
    """
    from tensorly import tucker_to_tensor

    upper = np.triu_indices(model.covariances_[model.frame_names_[0]].shape[1])
    tensor = np.stack(
        [
            np.hstack([model.means_[name][:, 1:], _of_eigenvalues(model.covariances_[name], np.log)[:, *upper]])
            for name in model.frame_names_
        ]
    )
    centre, scale = tensor.mean(axis=(0, 1)), tensor.std(axis=(0, 1)) + 1e-12
    normal = (tensor - centre) / scale
    ranks = [needed(shares, kept) for shares in energies(decomposed(normal, normal.shape)[0])]
    core, factors = decomposed(normal, ranks)
    back = np.asarray(tucker_to_tensor((core, factors))) * scale + centre
    result, D = deepcopy(model), model.means_[model.frame_names_[0]].shape[1] - 1
    for name, numbers in zip(model.frame_names_, back, strict=True):
        logs = np.zeros_like(model.covariances_[name])
        logs[:, *upper] = numbers[:, D:]
        logs[:, *upper[::-1]] = numbers[:, D:]
        result.means_[name] = np.column_stack([model.means_[name][:, 0], numbers[:, :D]])
        result.covariances_[name] = _of_eigenvalues(logs, np.exp)
    return result, core.size + sum(factor.size for factor in factors) + 2 * len(centre), tensor.size


def _of_eigenvalues(matrices: Array, function: Any) -> Array:
    """A function of symmetric matrices (..., n, n)."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray((vectors * function(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def compression(shown: Sequence[Demonstration]) -> list[tuple[float, float, float]]:
    """Kept share, numbers of the model over those before, and RMSE of demonstrations that were left out, m."""
    found: dict[float, list[tuple[float, float]]] = {kept: [] for kept in (1.0, *KEPT[::-1])}
    for m, asked in enumerate(progress(shown, "compressing models")):
        model = Recipe.of({"n_steps": 50}, "time_steps").learn([*shown[:m], *shown[m + 1 :]], POSITIONS)
        for kept, results in found.items():
            smaller, numbers, before = (model, 1, 1) if kept == 1.0 else compressed(model, kept)
            distances = np.sum((reproduce(smaller, asked) - asked.data[:, 1:]) ** 2, axis=1)
            results.append((numbers / before, float(np.sqrt(np.mean(distances)))))
    return [(kept, *np.mean(results, axis=0).tolist()) for kept, results in found.items()]


def draw(names: Sequence[str], shares: Array, factors: Sequence[Array], modes: Sequence[Array]) -> Figure:
    """Energies, eigenframes, eigentrajectories, eigenposes, and who explains whom."""
    figure = canvas(13.0, 6.5)
    (energy, frames, who), (trajectories, poses, empty) = figure.subplots(2, 3)
    for title, own in zip(MODES, modes, strict=True):
        energy.plot(np.arange(1, len(own) + 1), 100.0 * np.cumsum(own), "o-", label=title, markersize=3)
    energy.set(title="kept by so many", xlabel="number", ylabel="% of squares", xlim=(0.5, 12.5))
    energy.legend(loc="lower right")
    for axes, factor, title, rows in (
        (frames, factors[0], "eigenframes", list(names)),
        (poses, factors[3], "eigenposes", ["x", "y", "z"]),
    ):
        axes.imshow(factor, cmap="RdBu", vmin=-1.0, vmax=1.0, aspect="auto")
        axes.set(title=title, yticks=range(len(rows)), yticklabels=rows, xticks=range(factor.shape[1]))
    trajectories.plot(np.linspace(0.0, 100.0, len(factors[2])), factors[2][:, :3], label=["1", "2", "3"])
    trajectories.set(title="eigentrajectories", xlabel="% of the movement")
    trajectories.legend()
    who.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in np.ndindex(*shares.shape):
        who.text(j, i, f"{shares[i, j]:.2f}", ha="center", va="center", color="w" if shares[i, j] > 0.6 else "k")
    ticks = range(len(names))
    who.set(title="row explains column (left out)", xticks=ticks, yticks=ticks, yticklabels=names)
    who.set_xticklabels(names, rotation=20)
    empty.axis("off")
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = options_of(__doc__, "frame_tensor")
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="(default: %(default)s)")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="(default: %(default)s)")
    parser.add_argument("--twin", metavar="FRAME", help="add a frame that is fixed to this one: it has to be found")
    options = parser.parse_args(arguments)
    if find_spec("tensorly") is None:
        print("frame_tensor: TensorLy is not installed: .venv/bin/python -m pip install tensorly", file=sys.stderr)
        return 1
    recorded = read_demonstrations(find_bags([options.bags]), Task.load(options.task))[0]
    shortest = min(len(item.times) for item in recorded)
    shown = [thinned(positions_alone(item), min(SAMPLES, shortest)) for item in recorded]
    if options.twin is not None and options.twin not in shown[0].frames:
        print(f"frame_tensor: --twin is one of {', '.join(shown[0].frames)}, not {options.twin}", file=sys.stderr)
        return 2
    if options.twin is not None:
        shown = [with_twin(item, options.twin) for item in shown]
    names, seen = list(shown[0].frames), views(shown)
    deviations = seen - seen.mean(axis=1, keepdims=True)
    core, factors = decomposed(deviations, deviations.shape)
    modes, shares = energies(core), explained(seen)
    same = redundant(names, shares)
    for name, other in same.items():
        print(f"{name} is redundant: {other} explains {shares[names.index(other), names.index(name)]:.1%} of its view")
    lines = [
        (title, str(len(own)), *(str(needed(own, kept)) for kept in KEPT))
        for title, own in zip(MODES, modes, strict=True)
    ]
    print(format_table(("of the demonstrations", "all", *(f"for {kept:.1%}" for kept in KEPT)), lines))
    sizes = compression(shown)
    print(
        format_table(
            ("kept of the model", "size", "RMSE left out, m"),
            [(f"{k:.1%}", f"{s:.2f}", f"{e:.4f}") for k, s, e in sizes],
        )
    )
    whole = sizes[0][2]
    rows: list[Row] = [
        at_most("the model that keeps 99 %: its error over that of the whole one", sizes[2][2] / whole, 1.5),
        at_most("its size over that of the whole one", sizes[2][1], 0.75),
    ]
    if options.twin is not None:
        rows.append(at_least("the twin is found", float(same.get(options.twin + TWIN) == options.twin), 1.0))
    return finish("frame_tensor", draw(names, shares, factors, modes), rows, options.output)


if __name__ == "__main__":
    sys.exit(main())
