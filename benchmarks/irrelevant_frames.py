# SPDX-License-Identifier: Apache-2.0
"""What frames that do not matter cost, and what the screen makes of them: leave-one-out, the screen made in each fold.

To the recordings' own frames are added some at random places, anew in each demonstration, and some that hardly move.
Models are learned of all frames, of those that the screen keeps, and of both with frames left out of the segments in
which they predict badly (`prune`), with the same settings for all.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from tqdm import tqdm  # noqa: E402

from tpgmm_core import Demonstration, Frame  # noqa: E402
from tpgmm_core.choice.candidates import frame_candidates, in_order_of_preference  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce  # noqa: E402
from tpgmm_core.choice.trial import SAMPLES, thinned  # noqa: E402
from tpgmm_core.common.report import format_table  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.learning.frame_screen import screen_frames  # noqa: E402
from tpgmm_core.model.derived_frames import with_frames  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.programs.reporting import write_report  # noqa: E402
from tpgmm_ros.recordings.bags import Recording, align, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

SETS = (
    ("config/baxter_valve.yaml", "../shared/data/baxter_valve"),
    ("config/franka_bolts.yaml", "../shared/data/franka_bolts"),
    ("config/pick_place.yaml", "bags/pick_place"),
)
type Errors = np.ndarray[tuple[int], np.dtype[np.float64]]

SETTINGS = {"n_components": 7, "covariance": "diag", "reg_covar": 1e-4, "max_iter": 100}
BORNE = 1.1
"""Largest error with frames that do not matter, once they are screened, over that without them."""
PRUNE = 0.4
"""Relevance below which a frame is left out of a segment."""
STILL_NOISE = (0.005, 0.02)
"""How far the frames that hardly move do so, standard deviation, m and rad."""


def with_irrelevant(recordings: Sequence[Recording], seed: int, phantoms: int, still: int) -> list[Recording]:
    """The recordings with frames that do not matter, in the room that the hand was in."""
    rng = np.random.default_rng(seed)
    positions = np.vstack([recording.movement[:, :3] for recording in recordings])
    low, high = positions.min(axis=0), positions.max(axis=0)

    def anywhere() -> np.ndarray[Any, Any]:
        return np.concatenate([rng.uniform(low, high), quaternion.normalize(rng.normal(size=4))])

    places = [anywhere() for _ in range(still)]
    extended = []
    for recording in recordings:
        more = {f"phantom_{i}": anywhere() for i in range(phantoms)}
        for i, place in enumerate(places):
            moved = place[:3] + STILL_NOISE[0] * rng.normal(size=3)
            turn = quaternion.exp(STILL_NOISE[1] * rng.normal(size=3))
            more[f"still_{i}"] = np.concatenate([moved, quaternion.multiply(place[3:], turn)])
        T = len(recording.times)
        frames = recording.frames | {name: np.tile(pose, (T, 1)) for name, pose in more.items()}
        visible = recording.visible | {name: np.ones(T, bool) for name in more}
        extended.append(replace(recording, frames=frames, visible=visible))
    return extended


def demonstrations_of(recordings: Sequence[Recording]) -> tuple[list[Demonstration], str]:
    """Over [time, pose], or [time, position] where no orientation was recorded; and the space."""
    shown = [thinned(item, SAMPLES) for item in align(recordings)[0]]
    if any((item.data[:, 4:] != quaternion.IDENTITY).any() for item in shown):
        return shown, "R1 x R3 x S3"
    return [
        Demonstration(
            item.times,
            item.data[:, :4],
            {name: Frame(frame.A[..., :4, :4], frame.b[..., :4]) for name, frame in item.frames.items()},
            item.visible,
        )
        for item in shown
    ], "R1 x R3"


def errors(recordings: Sequence[Recording], method: str, is_screened: bool) -> tuple[Errors, Errors, set[str]]:
    """RMSE of positions of what was left out, m, without and with PRUNE, and all frames that models were learned of."""
    shown, space = demonstrations_of(recordings)
    found: tuple[list[float], list[float]] = [], []
    used = set[str]()
    for i, left_out in enumerate(shown):
        others = shown[:i] + shown[i + 1 :]
        frames, situation = tuple(left_out.frames), left_out
        if is_screened:
            derived = frame_candidates(others)
            others = [derived.extended(item) for item in others]
            situation = derived.extended(left_out)
            frames = tuple(screen_frames(others, in_order_of_preference(others, derived)).shares())
        used |= set(frames)
        others, situation = [with_frames(item, frames) for item in others], with_frames(situation, frames)
        for errors_of_kind, prune in zip(found, (0.0, PRUNE), strict=True):
            path = reproduce(Recipe.of({**SETTINGS, "prune": prune}, method).learn(others, space), situation)
            off = np.sum((path[:, :3] - left_out.data[:, 1:4]) ** 2, axis=1)
            errors_of_kind.append(float(np.sqrt(np.mean(off))))
    return np.array(found[0]), np.array(found[1]), used


def more(pruned: Errors, whole: Errors) -> str:
    """By how much errors change, with the standard error of that."""
    change = pruned - whole
    return f"{change.mean():+.4f} ± {change.std(ddof=1) / np.sqrt(len(change)):.4f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--set", nargs=2, action="append", metavar=("TASK", "BAGS"), help="task file, directory of bags"
    )
    parser.add_argument("--first", type=int, metavar="M", default=6, help="first M recordings (default: 6)")
    parser.add_argument("--phantoms", type=int, default=10, help="frames at random places (default: 10)")
    parser.add_argument("--still", type=int, default=10, help="frames that hardly move (default: 10)")
    parser.add_argument("--seeds", type=int, default=5, help="so many times (default: 5)")
    parser.add_argument("--method", default="regress_product", help="of retrieval (default: regress_product)")
    parser.add_argument("--output", type=Path, default=Path("out/results/irrelevant_frames"), help="of report.json")
    options = parser.parse_args(arguments)
    report: dict[str, Any] = {}
    rows: list[tuple[str, ...]] = []
    for task_file, directory in options.set or SETS:
        if not Path(directory).is_dir():
            print(f"irrelevant_frames: {directory} left out, it is no directory")
            continue
        task = Task.load(task_file)
        recordings, bad = read_recordings(find_bags([directory]), task)
        if bad:
            raise bad[0]
        recordings = recordings[: options.first]
        plain, plain_pruned, _ = errors(recordings, options.method, False)
        base, base_pruned, _ = errors(recordings, options.method, True)
        kinds = (plain, plain_pruned, base, base_pruned)
        rows.append(
            (task.name, "none", *(f"{kind.mean():.4f}" for kind in kinds))
            + (more(plain_pruned, plain), more(base_pruned, base), "", "")
        )
        report[task.name] = {
            "frames_of_the_task": plain.mean(),
            "frames_of_the_task_pruned": plain_pruned.mean(),
            "screened": base.mean(),
            "screened_pruned": base_pruned.mean(),
            "seeds": [],
        }
        for seed in tqdm(range(options.seeds), desc=task.name, disable=None, file=sys.stderr):
            extended = with_irrelevant(recordings, seed, options.phantoms, options.still)
            whole, pruned, _ = errors(extended, options.method, False)
            kept, kept_pruned, used = errors(extended, options.method, True)
            intruders = sorted(name for name in used if name.startswith(("phantom", "still")))
            share = kept.mean() / base.mean()
            rows.append(
                (task.name, f"seed {seed}", *(f"{kind.mean():.4f}" for kind in (whole, pruned, kept, kept_pruned)))
                + (more(pruned, whole), more(kept_pruned, kept), f"{share - 1.0:+.1%}", str(len(intruders)))
            )
            row = {
                "seed": seed,
                "all": whole.mean(),
                "all_pruned": pruned.mean(),
                "screened": kept.mean(),
                "screened_pruned": kept_pruned.mean(),
                "intruders": intruders,
            }
            report[task.name]["seeds"].append(row)
    print(
        f"\n{options.phantoms} frames at random places and {options.still} that hardly move; mean RMSE of positions, m"
    )
    head = ("data", "added", "all frames", "pruned", "screened", "screened, pruned", "pruned - all")
    print(format_table((*head, "pruned - screened", "screened against none added", "added frames kept"), rows))
    if not report:
        print("irrelevant_frames: skipped, there is no data set")
        return 0
    passed = all(seed["screened"] <= BORNE * item["screened"] for item in report.values() for seed in item["seeds"])
    print(f"report: {write_report(options.output, {'passed': passed, **report})}")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
