# SPDX-License-Identifier: Apache-2.0
"""What `convert --lerobot` does: bags of a task to one LeRobot dataset."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

import numpy as np

from tpgmm_core.common.text import counted, listed
from tpgmm_ros.programs.reading import TrainingError, progress_bar
from tpgmm_ros.recordings.bags import find_bags, join_parts, read_recordings
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.lerobot_layout import parquet
from tpgmm_ros.recordings.conversion.lerobot_writing import write_dataset
from tpgmm_ros.recordings.conversion.resampling import rate_of, sampled
from tpgmm_ros.recordings.judging import doubts_about
from tpgmm_ros.task.task_file import Task

WHOLE = 0.02
"""A rate is taken for the nearest whole number where it differs by less than this share."""


def to_lerobot(options: argparse.Namespace, report: dict[str, Any]) -> None:
    """Write the dataset.

    Parameters
    ----------
    options
        files, to, task, rate
    report
        what was found is written there: bags, bad_bags, doubts, dataset, rate_hz

    Raises
    ------
    ConversionError
        pyarrow is missing, the rate is no whole number, or the dataset does not hold what was written.
    TrainingError
        a bag is bad, or doubts refuse the bags.
    """
    parquet()
    task = Task.load(options.task)
    bags = join_parts(find_bags(options.files), task.movement)
    with progress_bar(total=len(bags), desc="reading bags", unit="bag") as bar:
        recordings, bad = read_recordings(bags, task, progress=lambda _: bar.update())
    report["bad_bags"] = [{"bag": str(error.path), "error": str(error)} for error in bad]
    if bad or not recordings:
        raise TrainingError(f"{len(bad)} of {counted(len(bags), 'bag')} cannot be read, nothing was written")
    doubts = doubts_about(recordings, task)
    report["doubts"] = [asdict(doubt) for doubt in doubts]
    if any(doubt.refuses for doubt in doubts):
        raise TrainingError("these bags do not belong together, nothing was written")
    if recordings[0].stretches:
        maps = listed(recordings[0].stretches)
        raise ConversionError(f"a dataset has poses of frames, and {maps} are maps: leave them out of the task file")
    fps = _rate(options.rate, rate_of(recordings))
    found = [sampled(one, fps) for one in recordings]
    with progress_bar(total=len(found), desc="writing episodes", unit="episode") as bar:
        write_dataset(options.to, [one.recording for one in found], fps, task.name, task.space.joints(), bar.update)
    for recording, one in zip(recordings, found, strict=True):
        notes = list(recording.notes)
        if one.off_m or len(one.recording.times) != len(recording.times):
            notes.append(
                f"{recording.place}: {len(recording.times)} samples became {len(one.recording.times)} at {fps} Hz, "
                f"at most {1e3 * one.off_m:.2f} mm away from them"
            )
        report["bags"].append(
            {
                "bag": recording.place,
                "samples": len(one.recording.times),
                "duration_s": one.recording.duration,
                "rate_hz": float(fps),
                "extent_m": float(np.linalg.norm(np.ptp(one.recording.movement[:, :3], axis=0))),
                "notes": notes,
            }
        )
    report["dataset"], report["rate_hz"] = str(options.to), fps


def _rate(given: float | None, there: float) -> int:
    rate = there if given is None else given
    whole = max(1, round(rate))
    if abs(whole - rate) > (WHOLE * rate if given is None else 0.0):
        raise ConversionError(
            f"LeRobot datasets have a whole number of samples per second, these have {rate:.4g}: name one by --rate"
        )
    return whole
