# SPDX-License-Identifier: Apache-2.0
"""`recognize`: which skill is shown in recordings, how early that is known, and which skills a long recording holds."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import one_line
from tpgmm_core.recognition.recognizer import UNKNOWN, RecognitionConfig, Recognizer
from tpgmm_core.recognition.segmentation import segment
from tpgmm_ros.models.known_skills import load_skills
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.recordings.bags import Recording, find_bags, read_recordings
from tpgmm_ros.runtime.arguments import number_above_0, whole_number
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.task.task_file import Task

SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
EXAMPLES = """\
examples:
  recognize --task config/pick_place.yaml --skill reach=reach.tpgmm --skill place=place.tpgmm bags/new
  recognize --task TASK --skill reach=reach.tpgmm=3 --skill place=place.tpgmm --expect place bags/placed
  recognize --task TASK --skill reach=reach.tpgmm --skill place=place.tpgmm --segments bags/a_long_one
"""


def watched(recognizer: Recognizer, recording: Recording) -> list[dict[str, float]]:
    """Probabilities of the classes after each of `SHARES` of a recording."""
    shown = recording.to_demonstration()
    visible = {name: shown.is_visible(name) for name in shown.frames}
    recognizer.start()
    found = []
    for t, time in enumerate(shown.times):
        frames = {name: frame.at(t) for name, frame in shown.frames.items() if visible[name][t]}
        found.append(recognizer.step(round(1e9 * time), shown.data[t, 1:], frames))
    ends = [max(1, round(share * len(found))) - 1 for share in SHARES]
    return [dict(found[end].probabilities) for end in ends]


def classify(recognizer: Recognizer, recordings: Sequence[Recording], expected: str | None) -> dict[str, Any]:
    """Print what each recording is taken for.

    Parameters
    ----------
    recognizer
        of the skills
    recordings
        each of one movement
    expected
        what they should be taken for; None: that does not matter

    Returns
    -------
    dict[str, Any]
        what the report says
    """
    names = [*recognizer.names, UNKNOWN]
    rows, report = [], []
    for recording in recordings:
        course = watched(recognizer, recording)
        best = [max(row, key=row.__getitem__) for row in course]
        rows.append((recording.name, *(f"{name} {row[name]:.2f}" for name, row in zip(best, course, strict=True))))
        report.append({"bag": recording.place, "found": best[-1], "shares": list(SHARES), "probabilities": course})
    print("most probable, after so much of each recording")
    print(format_table(("recording", *(f"{share:.0%}" for share in SHARES)), rows))
    counts = {name: sum(item["found"] == name for item in report) for name in names}
    print("found: " + ", ".join(f"{count} × {name}" for name, count in counts.items()))
    passed = expected is None or counts[expected] == len(recordings)
    if expected is not None:
        print(f"expected: {expected}, in {counts[expected]} of {len(recordings)}")
    return {"passed": passed, "expected": expected, "counts": counts, "recordings": report}


def take_apart(recognizer: Recognizer, recordings: Sequence[Recording], config: RecognitionConfig) -> dict[str, Any]:
    """Print the segments of each recording.

    Parameters
    ----------
    recognizer
        of the skills
    recordings
        of one or more movements each
    config
        as of the recognizer

    Returns
    -------
    dict[str, Any]
        what the report says
    """
    skills = [one.skill for one in recognizer.filters]
    rows, report = [], []
    for recording in recordings:
        times = np.append(recording.times, recording.times[-1])
        for part in segment(skills, recording.to_demonstration(), config):
            first, end = float(times[part.first]), float(times[part.end])
            rows.append((recording.name, part.name, f"{first:.2f}", f"{end:.2f}"))
            report.append({"bag": recording.place, "skill": part.name, "from_s": first, "to_s": end})
    print(format_table(("recording", "skill", "from s", "to s"), rows))
    return {"passed": True, "segments": report}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = _parser().parse_args(arguments)
    try:
        report = _run(options)
        if options.report is not None:
            print(f"report: {write_report(options.report, report)}")
    except (ValueError, OSError) as error:  # a BagError is a ValueError
        print(f"error: {one_line(error, 500)}", file=sys.stderr)
        return 1
    return 0 if report["passed"] else 1


def _run(options: argparse.Namespace) -> dict[str, Any]:
    task = Task.load(options.task)
    config = RecognitionConfig(memory=options.memory, unknown_prior=options.unknown_prior)
    recognizer = Recognizer(load_skills(options.skill, task), config)
    if options.expect not in (None, UNKNOWN, *recognizer.names):
        raise ValueError(f"--expect {options.expect}: there is no such skill; known are {recognizer.names}")
    recordings, bad = read_recordings(find_bags(options.bags), task, options.every)
    if bad:
        raise bad[0]
    if options.segments:
        return take_apart(recognizer, recordings, config)
    return classify(recognizer, recordings, options.expect)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="recognize",
        description="Recognise which of several skills recordings show, or find the skills in a long recording.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bags", metavar="BAG", nargs="+", type=a_path, help="bag, or a directory with several bags")
    parser.add_argument("--task", required=True, type=a_path, help="task file: topics and frames of all skills")
    parser.add_argument(
        "--skill",
        required=True,
        action="append",
        metavar="NAME=FILE[=PRIOR]",
        help="a skill, its model file and its prior weight against the others (default: 1); may be repeated",
    )
    parser.add_argument(
        "--expect", metavar="NAME", help="exit status 1 unless every recording is recognised as this skill at its end"
    )
    parser.add_argument("--segments", action="store_true", help="split each recording into skills")
    default = RecognitionConfig()
    parser.add_argument(
        "--memory", type=number_above_0("a time in s"), default=default.memory, metavar="S",
        help="time within which everything that is seen counts as one observation, s (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--unknown-prior", type=float, default=default.unknown_prior, metavar="P",
        help="probability of a movement that is none of the skills (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--every", type=whole_number(1), default=1, metavar="N", help="use every N-th sample (default: all)"
    )
    parser.add_argument("--report", type=a_path, metavar="DIR", help="directory of report.json")
    return parser


if __name__ == "__main__":
    sys.exit(main())
