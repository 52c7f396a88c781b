# SPDX-License-Identifier: Apache-2.0
"""`inspect`: what is in bags, what makes no sense in them, and a task file to begin with. Needs no running ROS."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_ros.programs.reporting import json_text
from tpgmm_ros.recordings.bags import BagError, Recording, find_bags, join_parts, read_recordings
from tpgmm_ros.recordings.judging import doubts_about
from tpgmm_ros.recordings.overview import BagOverview, overview_of
from tpgmm_ros.recordings.proposed_takes import several_movements
from tpgmm_ros.recordings.suggestion import suggested_task
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.task.task_file import Task

EXAMPLES = """\
examples:
  inspect bags/mine                                  (topics, rates, pauses, problems, a suggested task file)
  inspect --write my_task.yaml bags/mine             (writes the suggested task file)
  inspect --task config/pick_place.yaml bags/mine    (problems that train would report for this task)

exit status: 0 the bags can be read; 1 one of them cannot, or has problems and --strict is given; 2 wrong arguments
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = _parser().parse_args(arguments)
    try:
        found = _inspect(options)
    except (OSError, ValueError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        if options.json:
            print(json_text({"passed": False, "error": one_line(error)}))
        return 1
    for bag in found["bad_bags"]:
        print(f"bad bag: {one_line(bag['error'])}", file=sys.stderr)
    print(json_text(found) if options.json else _text(found))
    return 0 if found["passed"] else 1


def _inspect(options: argparse.Namespace) -> dict[str, Any]:
    given = Task.load(options.task) if options.task else None
    paths = find_bags(options.bags)
    if not options.separate:
        paths = join_parts(paths, given.movement if given else None)
    good: list[BagOverview] = []
    bad = []
    for path in paths:
        try:
            good.append(overview_of(path))
        except BagError as error:
            bad.append({"bag": str(path), "error": str(error)})
    suggestion = suggested_task(good) if good else None
    text = suggestion.text if suggestion else ""
    task = given or (Task.from_text(text, "the suggested task") if text else None)
    doubts: list[Doubt] = []
    recordings: list[Recording] = []
    hints = list(suggestion.hints) if suggestion else []
    if task is not None:
        recordings, refused = read_recordings([bag.path for bag in good], task)
        if task.takes is None and recordings:
            found = several_movements(recordings)
            hints += found.hints
            if found.entry and given is None:
                text += found.line
                recordings, refused = read_recordings([bag.path for bag in good], Task.from_text(text, "suggestion"))
        doubts = doubts_about(recordings, task) if recordings else []
        bad += [{"bag": str(error.path), "error": str(error)} for error in refused]
    written = None
    if options.write is not None:
        if not text:
            raise ValueError(f"no task file can be suggested: {suggestion.reason if suggestion else 'no bag was read'}")
        if options.write.exists():
            raise ValueError(f"{options.write} exists, and is not overwritten: move it, or give another name")
        write_atomically(options.write, lambda file: file.write_text(text))
        written = str(options.write)
    stops = bool(bad) or any(doubt.refuses for doubt in doubts) or (options.strict and bool(doubts))
    return {
        "passed": not stops,
        "bags": [_of_bag(bag) for bag in good],
        "bad_bags": bad,
        "demonstrations": [
            {"name": one.place, "duration_s": one.duration, "samples": len(one.times)} for one in recordings
        ],
        "notes": [f"{one.place}: {note}" for one in recordings for note in one.notes],
        "doubts": [asdict(doubt) for doubt in doubts],
        "suggested_task": text,
        "no_task_because": suggestion.reason if suggestion else "no bag could be read",
        "hints": hints,
        "written": written,
    }


def _of_bag(bag: BagOverview) -> dict[str, Any]:
    topics = [
        {
            "name": topic.name,
            "type": topic.type,
            "messages": topic.count,
            "rate_hz": topic.rate_hz,
            "longest_gap_s": topic.gap_s,
            "frame_ids": list(topic.frame_ids),
            "moves": topic.moves,
            "path_m": topic.path_m,
        }
        for topic in bag.topics
    ]
    return {"bag": str(bag.path), "duration_s": bag.duration_s, "topics": topics}


def _text(found: dict[str, Any]) -> str:
    parts = []
    for bag in found["bags"]:
        rows = [
            (
                topic["name"],
                topic["type"],
                topic["messages"],
                f"{topic['rate_hz']:.1f}" if topic["rate_hz"] else "-",
                f"{topic['longest_gap_s']:.2f}" if topic["longest_gap_s"] else "-",
                listed(topic["frame_ids"], 3) if topic["frame_ids"] else "-",
                f"{topic['path_m']:.3g}" if topic["moves"] else ("still" if topic["frame_ids"] else "-"),
            )
            for topic in bag["topics"]
        ]
        head = ("topic", "type", "messages", "Hz", "gap s", "frame", "moves m")
        parts.append(f"{one_line(bag['bag'])}: {bag['duration_s']:.2f} s\n{format_table(head, rows)}")
    if len(found["demonstrations"]) > len(found["bags"]):
        takes = [(one_line(one["name"]), f"{one['duration_s']:.2f}", one["samples"]) for one in found["demonstrations"]]
        parts.append(format_table(("demonstration", "s", "samples"), takes))
    parts += [one_line(note) for note in found["notes"]]
    parts += [f"{'refused' if doubt['refuses'] else 'doubt'}: {Doubt(**doubt)}" for doubt in found["doubts"]]
    if found["demonstrations"] and not found["doubts"] and not found["bad_bags"]:
        parts.append("no doubts: the values are plausible")
    if found["suggested_task"]:
        parts.append(f"suggested task file:\n\n{found['suggested_task']}".rstrip())
    else:
        parts.append(f"no task file can be suggested: {found['no_task_because']}")
    parts += [f"look at: {hint}" for hint in found["hints"]]
    if found["written"]:
        parts.append(f"task file: {found['written']}")
    return "\n\n".join(parts)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="inspect",
        description="Show the content of recorded bags and problems in them, and suggest a task file.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "bags",
        metavar="BAG",
        nargs="+",
        type=a_path,
        help="bag, one of its files, or a directory with several of them",
    )
    parser.add_argument(
        "--task", type=a_path, help="task file by which the bags are checked (default: the suggested one)"
    )
    parser.add_argument(
        "--write", type=a_path, metavar="FILE", help="write the suggested task file; existing files are not overwritten"
    )
    parser.add_argument(
        "--separate",
        action="store_true",
        help="bags that continue another bag are separate demonstrations, not parts of one recording",
    )
    parser.add_argument("--strict", action="store_true", help="exit status 1 if there is any problem")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
