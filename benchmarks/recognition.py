# SPDX-License-Identifier: Apache-2.0
"""Which skill is shown: held-out accuracy, calibration of probabilities and the time of a step, on three data sets.

Phases of recordings (to an object, from there on, back from the next one) are one skill each; each recording is left
out of all models in turn. Drawings are six planar shapes between places that are never the same. Probabilities are
calibrated if of what is said with probability p, a share p is so: the table has both, over all moments of all
movements, in bins of p.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402

from benchmarks.report import write_report  # noqa: E402
from tpgmm_core import Demonstration  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.recognition.recognizer import Recognizer  # noqa: E402
from tpgmm_core.recognition.skill import Skill  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.recordings.bags import find_bags, read_recordings  # noqa: E402
from tpgmm_ros.recordings.recording import Recording  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

PHASES = ("approach", "between", "retreat")
SHARES = (0.25, 0.5, 1.0)
"""Of a movement, after which the most probable class is looked at."""
BINS = (0.0, 0.5, 0.8, 0.95, 1.0)
ACCURATE = 0.9
"""Share of whole movements that are to be told apart."""
QUICK = 1.0
"""Processor time within which half of the steps are to be done, ms."""
OVERCONFIDENT = 0.1
"""By how much the mean probability of what is most probable may exceed the share of it that is right."""
VALVE_SCALE, PICK_SCALE = 2.6, 1.5
"""Of covariances, as `train --leave-one-out` finds it for whole movements of these recordings."""

type Fold = tuple[Recognizer, str, Demonstration]


def phases(recording: Recording, frames: Sequence[str]) -> dict[str, Demonstration]:
    """The parts between the moments at which the hand is nearest to each of some frames; each from time 0."""
    apart = [np.linalg.norm((recording.movement - recording.frames[name])[:, :3], axis=1) for name in frames]
    ends = [0, *(int(distance.argmin()) for distance in apart), len(recording.times)]
    whole, found = recording.to_demonstration(), {}
    for name, first, end in zip(PHASES, ends, ends[1:], strict=False):
        times = whole.times[first:end] - whole.times[first]
        fixed = {frame: one.at(0) for frame, one in whole.frames.items()}
        found[name] = Demonstration(times, np.column_stack([times, whole.data[first:end, 1:]]), fixed)
    return found


def skill_of(name: str, shown: Sequence[Demonstration], scale: float) -> Skill:
    """A skill of some demonstrations, with a scale of covariances."""
    duration = float(np.mean([one.times[-1] for one in shown]))
    stretched = []
    for one in shown:
        times = one.times * duration / one.times[-1]
        stretched.append(Demonstration(times, np.column_stack([times, one.data[:, 1:]]), one.frames))
    model = Recipe.of({"n_components": 4, "reg_covar": 1e-3}).learn(stretched, "R1 x R3 x S3")
    return Skill(name, Skill.of_model(name, model).course, scale=scale)


def phases_left_out(task: Task, bags: Path, frames: Sequence[str], scale: float, every: int) -> Iterator[Fold]:
    """Each phase of each recording, with a recognizer that has not seen this recording."""
    recordings, bad = read_recordings(find_bags([bags]), task, every)
    if bad:
        raise bad[0]
    shown = [phases(recording, frames) for recording in recordings]
    for i, left_out in enumerate(shown):
        others = shown[:i] + shown[i + 1 :]
        recognizer = Recognizer([skill_of(name, [one[name] for one in others], scale) for name in left_out])
        for name in left_out:
            yield recognizer, name, left_out[name]


def drawings() -> Iterator[Fold]:
    """Six shapes, each drawn ten times in places that are new."""
    from drawings import SHAPES, drawn, skills

    recognizer, rng = Recognizer(skills()), np.random.default_rng(100)
    for shape in SHAPES:
        for _ in range(10):
            yield recognizer, shape, drawn(shape, rng)


def measure(name: str, folds: Iterator[Fold]) -> tuple[Row, list[Row]]:
    """A row of accuracy and of the processor time of a step; rows of calibration."""
    right: dict[float, list[bool]] = {share: [] for share in SHARES}
    said: list[tuple[float, bool]] = []
    steps: list[float] = []
    for recognizer, truth, shown in folds:
        recognizer.start()
        ends = {max(1, round(share * len(shown.times))): share for share in SHARES}
        for t, (now, point) in enumerate(zip(shown.times, shown.data[:, 1:], strict=True), start=1):
            began = time.thread_time()
            found = recognizer.step(round(1e9 * now), point, shown.frames)
            steps.append(time.thread_time() - began)
            said.append((found.probabilities[found.most_probable], found.most_probable == truth))
            if t in ends:
                right[ends[t]].append(found.most_probable == truth)
    p, is_right = np.array([one for one, _ in said]), np.array([one for _, one in said])
    accuracy = {f"right_after_{100 * share:.0f}": float(np.mean(right[share])) for share in SHARES}
    too_sure = float(p.mean() - is_right.mean())
    typical = 1e3 * float(np.median(steps))
    row: Row = {
        "data": name,
        "movements": len(right[1.0]),
        **{key: round(value, 3) for key, value in accuracy.items()},
        "mean_probability": round(float(p.mean()), 3),
        "right": round(float(is_right.mean()), 3),
        "step_p50_ms": round(typical, 3),
        "step_p99_ms": round(1e3 * float(np.percentile(steps, 99)), 3),
        "passed": bool(accuracy["right_after_100"] >= ACCURATE and too_sure <= OVERCONFIDENT and typical < QUICK),
    }
    return row, calibration(name, p, is_right)


def calibration(name: str, p: Array, is_right: Array) -> list[Row]:
    """What was said with a probability within each bin, and how much of it was so."""
    rows: list[Row] = []
    for low, high in zip(BINS, BINS[1:], strict=False):
        chosen = (p > low) & (p <= high)
        if chosen.any():
            rows.append(
                {
                    "data": name,
                    "said": f"{low:.2f} to {high:.2f}",
                    "moments": int(chosen.sum()),
                    "mean_probability": round(float(p[chosen].mean()), 3),
                    "right": round(float(is_right[chosen].mean()), 3),
                }
            )
    return rows


def data_sets(data: Path) -> dict[str, Callable[[], Iterator[Fold]]]:
    """By name; those of others only where they are."""
    sets: dict[str, Callable[[], Iterator[Fold]]] = {
        "drawings": drawings,
        "pick_place": lambda: phases_left_out(
            Task.load("config/pick_place.yaml"), Path("bags/pick_place"), ["object"], PICK_SCALE, 10
        ),
    }
    if (valve := data / "baxter_valve").is_dir():
        task = Task.load("config/baxter_valve.yaml")
        sets["valve"] = lambda: phases_left_out(task, valve, ["start", "valve"], VALVE_SCALE, 1)
    return sets


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="directory of data sets of others")
    options = parser.parse_args()
    accuracy, probabilities = [], []
    for name, folds in data_sets(options.data).items():
        row, rows = measure(name, folds())
        accuracy.append(row)
        probabilities += rows
    status = write_report("recognition", accuracy)
    return status | write_report("recognition_calibration", probabilities)


if __name__ == "__main__":
    sys.exit(main())
