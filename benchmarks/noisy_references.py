# SPDX-License-Identifier: Apache-2.0
"""What the tracker's filter makes of references to poses that tremble.

`PYTHONPATH=.:src/tpgmm_core/test:test .venv/bin/python benchmarks/noisy_references.py SEED ...` prints for each
retrieval method, over the whole pick-and-place: standard deviations of references, of any axis, as multiples of those
to exact poses; for how much of the time they differ by more than 10 %; and by how much the mean is off.
"""

from __future__ import annotations

import argparse

import numpy as np

from noisy_poses import BOUND, Noise, away, frames_of, lengths, rms, run, tracked_at
from test_noisy_poses import PLACES, RATE, learned
from tpgmm_core.observation.tracked import TrackingConfig
from tpgmm_core.retrieval.methods import METHODS

STEP = 0.02
NOISES = Noise(0.5), Noise(2.0)


def main(seeds: list[int]) -> None:
    """Print the table of all methods for these seeds of the noise."""
    print("| method | filter | standard deviations | beyond 10 % | off by |")
    for method in METHODS:
        model, start = learned(method)
        exact = run(model, method, lambda _: frames_of(PLACES), start, STEP)
        for filter_time in (0.0, TrackingConfig().filter_time):
            poses = [tracked_at(PLACES, noise, RATE, seed, filter_time) for noise in NOISES for seed in seeds]
            runs = [run(model, method, frames_at, start, STEP) for frames_at in poses]
            ratio = np.array([found.deviations / exact.deviations for found in runs])
            beyond = 100.0 * ((ratio > BOUND) | (ratio < 1.0 / BOUND)).any(axis=2).mean(axis=1)
            off = np.array([lengths(exact.manifold, rms(away(exact, found))) for found in runs]).max(axis=0)
            print(
                f"| `{method}` | {filter_time:g} s | {ratio.min():.2f} to {ratio.max():.2f} times | "
                f"{beyond.min():.1f} to {beyond.max():.1f} % | {1e3 * off[0]:.1f} mm, {np.degrees(off[1]):.2f} deg |",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="*", type=int, default=[5], metavar="SEED", help="of the noise (default: 5)")
    main(parser.parse_args().seeds)
