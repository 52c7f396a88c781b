# SPDX-License-Identifier: Apache-2.0
"""Few demonstrations of one half of a task, learned with the bases (synergies) of the other half.

Each recording is cut in the middle, and the time of each half begins at 0. Half of the recordings, drawn at random,
show the half that is known: a model with semi-tied covariances. Some of them show the other half, which is learned in
several ways; the rest of the recordings judge it: log-likelihood per sample, in nats, of the half that they show. A row
passes where the bases of the known half are better than full covariances; they are not to be with many demonstrations.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import write_report
from tpgmm_core import TPGMM, Demonstration
from tpgmm_core.common.report import Row
from tpgmm_ros.recordings.bags import align, find_bags, read_recordings
from tpgmm_ros.task.task_file import Task

K = 5
FEW = 3
"""Demonstrations up to which the bases of another task have to help."""
WAYS: dict[str, dict[str, Any]] = {
    "full": {},
    "semi_tied": {"covariance": "semi_tied"},
    "diag": {"covariance": "diag"},
    "tied": {"covariance": "tied"},
}


def halves(demonstration: Demonstration) -> tuple[Demonstration, Demonstration]:
    """Both halves of a demonstration over [time, pose] in frames at rest, each from time 0."""
    found = []
    middle = len(demonstration.times) // 2
    for part in (slice(None, middle), slice(middle, None)):
        data = demonstration.data[part].copy()
        data[:, 0] -= data[0, 0]
        found.append(Demonstration(data[:, 0], data, demonstration.frames))
    return found[0], found[1]


def compare(cut: Sequence[tuple[Demonstration, Demonstration]], known: int, few: int, options: Any) -> Row:
    """A row: `known` is the half (0, 1) that is known, `few` the number of demonstrations of the other one."""
    rules: dict[str, Any] = {"manifold": options.space, "reg_covar": 1e-6}
    scores: dict[str, list[float]] = {}
    for seed in range(options.draws):
        order = np.random.default_rng([options.seed, seed]).permutation(len(cut))
        shown, unseen = order[: len(cut) // 2], [cut[i][1 - known] for i in order[len(cut) // 2 :]]
        other = TPGMM(K, covariance="semi_tied", **rules).fit([cut[i][known] for i in shown])
        ways = {**WAYS, "bases": {"covariance": "semi_tied", "bases": other}}
        for name, settings in ways.items():
            model = TPGMM(K, prior_strength=options.prior, **rules, **settings)
            scores.setdefault(name, []).append(model.fit([cut[i][1 - known] for i in shown[:few]]).score(unseen))
    gain = np.subtract(scores["bases"], scores["full"])
    passed = bool(np.all(gain > 0.0)) if few <= FEW else None
    means = {name: round(float(np.mean(values)), 1) for name, values in scores.items()}
    return {
        "known": ("first", "second")[known],
        "few": few,
        **means,
        "better": int(np.sum(gain > 0.0)),
        "passed": passed,
    }


def main() -> int:
    """Print the table, and write out/bench/shared_bases.json."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="task file")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="directory of the bags")
    parser.add_argument("--every", type=int, default=8, metavar="N", help="use every N-th sample (default: 8)")
    parser.add_argument("--draws", type=int, default=10, metavar="N", help="random choices of recordings (default: 10)")
    parser.add_argument(
        "--prior", type=float, default=3.0, help="prior_strength of what is learned of few (default: 3)"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    task = Task.load(options.task)
    recordings, bad = read_recordings(find_bags([options.bags]), task, options.every)
    if bad:
        print(f"bad bag: {bad[0]}", file=sys.stderr)
        return 1
    options.space = task.space.manifold()
    cut = [halves(demonstration) for demonstration in align(recordings)[0]]
    return write_report("shared_bases", [compare(cut, known, few, options) for known in (0, 1) for few in (2, 3, 5, 8)])


if __name__ == "__main__":
    sys.exit(main())
