# SPDX-License-Identifier: Apache-2.0
"""End-point error of every retrieval method where frames are moved and turned beyond what was demonstrated.

Two tasks: pbdlib's planar data, whose second frame goes on along its way and turns on; and the pick-and-place
recordings, whose object and target are moved and turned from their mean by up to 4 times what they were in
demonstrations. What is expected is the end of the demonstrations, as seen from the frame that they end at. Movements
with a state of their own may take twice the time. No limit of a robot is regarded.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from tqdm import tqdm  # noqa: E402

from examples import pbdlib  # noqa: E402
from examples.report import write_report  # noqa: E402
from tpgmm_core import Demonstration, Frame, LearnedMixture  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce, without_frames  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.geometry.manifold import POSE  # noqa: E402
from tpgmm_core.geometry.pose import compose, inverse  # noqa: E402
from tpgmm_core.retrieval.methods import DEFAULT, METHODS  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_core.retrieval.trajectory import TrajectoryModel  # noqa: E402
from tpgmm_ros.recordings.bags import Recording, align, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.state_space import MANIFOLD  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

WITHOUT_FRAMES = "no frames"
FACTORS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
SAMPLES = 200
PANELS = (
    ("pick_place", "end_error", "pick-and-place: position", ("distance of the target (m)", "end-point error (m)")),
    ("pick_place", "end_error_deg", "pick-and-place: orientation", ("distance of the target (m)", "error (deg)")),
    ("pbdlib", "end_error", "pbdlib's planar data", ("distance of the second frame", "end-point error")),
)


@dataclass(frozen=True, slots=True)
class New:
    """A situation that was not demonstrated.

    It lies `factor` times the demonstrated range out; the last frame is so far from the middle of the demonstrated ones
    (m, or units of the data). Then: where a movement starts, its frames, and the end that is expected.
    """

    factor: float
    distance: float
    situation: Demonstration
    end: Array


def planar_task(demonstrations: Sequence[Demonstration]) -> list[New]:
    """The second frame beyond the last demonstration, on the line from the middle of the others."""
    seconds = [d.frames["second"] for d in demonstrations]
    middle = pbdlib.between(seconds[1], seconds[2], 0.5)
    seen = np.stack([d.projected()["second"][-1] for d in demonstrations]).mean(axis=0)
    found = []
    for factor in FACTORS:
        second = pbdlib.between(middle, seconds[3], factor)
        frames = {"first": demonstrations[0].frames["first"], "second": second}
        times = np.linspace(0.0, demonstrations[0].times[-1], SAMPLES)
        start = np.mean([d.data[0, 1:] for d in demonstrations], axis=0)
        distance = float(np.linalg.norm(second.b - middle.b))
        found.append(New(factor, distance, _still(times, start, frames), (second.A @ seen + second.b)[1:]))
    return found


def pose_task(recordings: Sequence[Recording], duration: float, last: str, every: int) -> list[New]:
    """Every n-th demonstrated situation, with each of its observed frames farther from the mean of that frame."""
    poses = {name: np.stack([r.frames[name][-1] for r in recordings]) for name in recordings[0].frames}
    means = {name: _mean_pose(several) for name, several in poses.items()}
    seen = _mean_pose(np.stack([compose(inverse(r.frames[last][-1]), r.movement[-1]) for r in recordings]))
    times = np.linspace(0.0, duration, SAMPLES)
    found = []
    for i, recording in list(enumerate(recordings))[::every]:
        for factor in FACTORS:
            places = {name: _farther(mean, poses[name][i], factor) for name, mean in means.items()}
            frames = {name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in places.items()}
            end = (frames[last].A @ np.concatenate([[0.0], seen]) + frames[last].b)[1:]
            distance = float(np.linalg.norm(places[last][:3] - means[last][:3]))
            found.append(New(factor, distance, _still(times, recording.movement[0], frames), end))
    return found


def _still(times: Array, start: Array, frames: Mapping[str, Frame]) -> Demonstration:
    return Demonstration(times, np.column_stack([times, np.tile(start, (len(times), 1))]), dict(frames))


def _mean_pose(poses: Array) -> Array:
    """(7,), of poses (M, 7); orientations by their principal direction (Markley et al. 2007)."""
    q = np.linalg.eigh(poses[:, 3:].T @ poses[:, 3:])[1][:, -1]
    return np.concatenate([poses[:, :3].mean(axis=0), q])


def _farther(mean: Array, pose: Array, factor: float) -> Array:
    """What lies from the mean pose as this one does, but so many times as far and turned by so many times the angle."""
    return POSE.exp(mean, factor * POSE.log(mean, pose))


def measure(
    task: str, learn: Callable[[str, Sequence[Demonstration]], LearnedMixture], demonstrations: Sequence[Demonstration],
    situations: Sequence[New],
) -> list[dict[str, Any]]:  # fmt: skip
    """A row for each method and situation: end-point errors, in the units of the data and degrees."""
    rows = []
    for method in tqdm([*METHODS, WITHOUT_FRAMES], desc=task, disable=None, file=sys.stderr):
        plain = method == WITHOUT_FRAMES
        model = learn(DEFAULT, [without_frames(d) for d in demonstrations]) if plain else learn(method, demonstrations)
        for new in situations:
            end = reproduce(model, without_frames(new.situation) if plain else new.situation, settle=1.0)[-1]
            row = {"task": task, "method": method, "factor": new.factor, "distance": new.distance}
            row["end_error"] = float(np.linalg.norm(end[:3] - new.end[:3]))
            if len(end) == 7:
                row["end_error_deg"] = float(np.degrees(quaternion.angle_between(end[3:], new.end[3:])))
            rows.append(row)
    return rows


def without_velocities(model: LearnedMixture, names: Sequence[str]) -> LearnedMixture:
    """A model over [time, x, velocity, acceleration] in the plane whose frames of these names hardly say velocities."""
    wider = np.array([1.0, 1.0, 1.0, 100.0, 100.0, 1.0, 1.0])  # standard deviations
    for name in names:
        model.covariances_[name] = model.covariances_[name] * np.outer(wider, wider)
    return model


def of_trajectory(demonstrations: Sequence[Demonstration], situations: Sequence[New]) -> list[Row]:
    """What the end-point errors of trajectory come from, in the plane: other models, and frames that say less."""

    def errors(frames: Sequence[str], silent: Sequence[str] = (), n_components: int = 3) -> dict[str, float]:
        recipe = Recipe.of({"n_components": n_components, "reg_covar": 1e-4}, "trajectory")
        model = without_velocities(recipe.learn(demonstrations, "R1 x R2"), silent)
        found = {}
        for new in situations:
            seen = {name: new.situation.frames[name] for name in frames}
            end = reproduce(model, _still(new.situation.times, new.situation.data[0, 1:], seen), settle=1.0)[-1]
            found[f"end_error_{new.factor:g}x"] = float(np.linalg.norm(end - new.end))
        return {key: found[key] for key in ("end_error_1x", "end_error_2x", "end_error_4x")}

    both = ("first", "second")
    rows: list[Row] = [{"model": f"K = {K}", **errors(both, n_components=K)} for K in (3, 6, 8, 10)]
    rows.append({"model": "K = 3, velocities of the second frame alone", **errors(both, ("first",))})
    rows.append({"model": "K = 3, no velocities", **errors(both, both)})
    rows.append({"model": "K = 3, second frame alone", **errors(("second",))})
    return rows


def speeds(demonstrations: Sequence[Demonstration], situations: Sequence[New]) -> list[Row]:
    """Speeds along the way from the first state of trajectory's model to the last one, in the plane.

    What that way needs in its time, and what the states say of it on average.
    """
    model = TrajectoryModel(
        Recipe.of({"n_components": 3, "reg_covar": 1e-4}, "trajectory").learn(demonstrations, "R1 x R2")
    )
    rows: list[Row] = []
    for new in situations:
        means, times = model.adapt(new.situation.frames).means, new.situation.times
        parts = [times[model.states(times) == k] for k in range(3)]
        displacement, duration = means[2, 1:3] - means[0, 1:3], float(parts[2].mean() - parts[0].mean())
        length = float(np.linalg.norm(displacement))
        counted = np.array([0.5, 1.0, 0.5]) * [
            np.ptp(part) for part in parts
        ]  # from the middle of a state to that of another
        said = float(counted @ means[:, 3:5] @ displacement / length / counted.sum())
        rows.append(
            {"factor": new.factor, "displacement": length, "speed_needed": length / duration, "speed_said": said}
        )
    return rows


def medians(rows: Sequence[Mapping[str, Any]], key: str) -> dict[str, tuple[Array, Array]]:
    """For each method: mean distances, and medians of an error, by factor."""
    result = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        several = [[row for row in rows if row["method"] == method and row["factor"] == factor] for factor in FACTORS]
        distances = np.array([np.mean([row["distance"] for row in some]) for some in several])
        result[method] = distances, np.array([np.median([row[key] for row in some]) for some in several])
    return result


def draw(axes: Axes, rows: Sequence[Mapping[str, Any]], key: str, title: str, labels: tuple[str, str]) -> None:
    """Errors against distance; dotted: 1, 2 and 4 times the demonstrated range."""
    for i, (method, (distances, values)) in enumerate(medians(rows, key).items()):
        # wider below narrower, so that lines which fall together are seen
        width = 5.0 - 0.6 * i
        style: dict[str, Any] = (
            {"color": "black", "ls": "--"} if method == WITHOUT_FRAMES else {"color": f"C{i}", "marker": "o"}
        )
        axes.plot(distances, values, markersize=1.5 * width, lw=width, label=method, **style)
    for factor in (1.0, 2.0, 4.0):
        at = float(distances[FACTORS.index(factor)])
        axes.axvline(at, color="0.7", ls=":", lw=1.0, zorder=0)
        axes.annotate(f"{factor:g} ×", (at, 1.0), xycoords=("data", "axes fraction"), ha="center", va="bottom")
    axes.set_yscale("log")
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_title(title, pad=18)
    axes.grid(alpha=0.3)


def table(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Medians for 1, 2 and 4 times the demonstrated range, a row for each method."""
    result: dict[str, dict[str, Any]] = {}
    for key, unit in (("end_error", ""), ("end_error_deg", "_deg")):
        if key not in rows[0]:
            continue
        for method, (_, values) in medians(rows, key).items():
            line = result.setdefault(method, {"task": rows[0]["task"], "method": method})
            line |= {f"end_error_{f:g}x{unit}": float(values[FACTORS.index(f)]) for f in (1.0, 2.0, 4.0)}
    return list(result.values())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=pbdlib.DATA, help="pbdlib's data (default: %(default)s)")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"))
    parser.add_argument("--situations", type=int, default=3, metavar="N", help="every N-th demonstrated one")
    parser.add_argument("--output", type=Path, default=Path("out/figures"), help="of extrapolation.json, .png")
    options = parser.parse_args(arguments)
    task = Task.load("config/pick_place.yaml")
    recordings, bad = read_recordings(find_bags([options.bags]), task, every=4)
    if bad:
        raise bad[0]
    demonstrations, duration = align(recordings)
    measured = {
        "pick_place": measure(
            "pick_place",
            lambda method, several: Recipe.of(task.model, method).learn(several, MANIFOLD),
            demonstrations,
            pose_task(recordings, duration, "target", options.situations),
        )
    }
    try:
        in_plane = pbdlib.demonstrations(options.data)
        measured["pbdlib"] = measure(
            "pbdlib",
            lambda method, several: Recipe.of({"n_components": 3, "reg_covar": 1e-4}, method).learn(several, "R1 x R2"),
            in_plane,
            planar_task(in_plane),
        )
        write_report("extrapolation_speeds", speeds(in_plane, planar_task(in_plane)), options.output)
        write_report("extrapolation_trajectory", of_trajectory(in_plane, planar_task(in_plane)), options.output)
    except FileNotFoundError as error:
        print(f"planar data left out: {error}")
    for name, rows in measured.items():
        write_report(f"extrapolation_{name}", table(rows), options.output)
    panels = [panel for panel in PANELS if panel[0] in measured]
    figure = Figure(figsize=(5.0 * len(panels), 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (name, key, title, labels) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        draw(axes, measured[name], key, title, labels)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, frameon=False)
    figure.savefig(options.output / "extrapolation.png", dpi=100)
    print(f"picture: {options.output / 'extrapolation.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
