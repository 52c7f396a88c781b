# SPDX-License-Identifier: Apache-2.0
"""`convert`: arrays of other programs to bags, with a task file for them, or bags to LeRobot. Needs no running ROS."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.yaml_values import is_name, is_topic
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_ros.programs.convert_lerobot import to_lerobot
from tpgmm_ros.programs.reading import TrainingError, progress_bar
from tpgmm_ros.programs.reporting import json_text, refuse_foreign
from tpgmm_ros.recordings.bags import read_recordings
from tpgmm_ros.recordings.conversion.columns import ORIENTATIONS, TIME_UNITS, UNITS
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.demonstrations import Columns, Shown, demonstrations_of
from tpgmm_ros.recordings.conversion.lerobot_layout import is_dataset
from tpgmm_ros.recordings.conversion.lerobot_reading import TIME, read_dataset
from tpgmm_ros.recordings.conversion.tables import Table, read_tables
from tpgmm_ros.recordings.conversion.written import BEGIN, MOVEMENT, audit, task_text, topic_of, topics_of, write_bag
from tpgmm_ros.recordings.judging import doubts_about
from tpgmm_ros.runtime.arguments import number_above_0
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.task.task_file import Task

EXAMPLES = """\
examples:
  convert --to bags/mine --time t --movement x,y,z,qx,qy,qz,qw --frame object=ox,oy,oz shown_*.csv
  convert --to bags/mine --time t --movement x,y,z --split episode --number gripper/width=width all.csv
  convert --to bags/mine --rate 100 --movement "[0:7]" demo_*.npy
  convert --to bags/mine --time t --movement hand --frame object=place --unit mm demos.npz
  convert --to bags/mine --time "s.Data0[0]" --movement "s.Data0[1:3]" Data02.mat
  convert --to bags/mine --rate 1000 --movement O_T_EE log.npz         (transforms, 4 by 4)
  convert --to bags/mine --movement "observation.state[0:7]" datasets/mine          (LeRobot v3.0)
  convert --to datasets/mine --lerobot --task my_task.yaml --rate 30 bags/mine      (to LeRobot v3.0)

Each element of an array of structs or cells (MATLAB), each element of the first axis of numpy arrays with three axes,
and each episode of a LeRobot dataset (whose features are columns) is a separate demonstration. No file is executed:
pickled objects are refused.

exit status: 0 everything was written, read back bit by bit, and fits the task file; 1 it was not, the reason is
printed; 2 wrong arguments
"""
TASK_FILE = "task.yaml"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.lerobot:
        if options.task is None or options.movement is not None or options.time is not None:
            parser.error(
                "--lerobot takes what is read from --task FILE: give --task, and leave out --movement and --time"
            )
    elif options.movement is None or options.task is not None:
        parser.error("give --movement COLUMNS; --task is only for --lerobot")
    elif folder := next((file for file in options.files if file.is_dir() and not is_dataset(file)), None):
        parser.error(f"{folder} is a folder, and none of a LeRobot dataset: name files, or the folder that holds meta")
    elif all(map(is_dataset, options.files)) and options.rate is None:
        options.time = options.time or TIME
    elif (options.time is None) == (options.rate is None):
        parser.error("give either --time COLUMN or --rate HZ")
    report: dict[str, Any] = {"passed": False, "bags": [], "bad_bags": []}
    try:
        if options.lerobot:
            to_lerobot(options, report)
        else:
            _convert(options, report)
        refused = any(doubt["refuses"] for doubt in report.get("doubts", []))
        report["passed"] = not report["bad_bags"] and not refused
    except (OSError, ValueError, TrainingError) as error:
        report["error"] = one_line(error)
        print(f"error: {report['error']}", file=sys.stderr)
    print(json_text(report) if options.json else _text(report))
    return 0 if report["passed"] else 1


def _convert(options: argparse.Namespace, report: dict[str, Any]) -> None:
    frames, numbers = _named("--frame", options.frame, is_name), _named("--number", options.number, is_topic)
    _check_names(options, frames, numbers)
    columns = Columns(
        options.movement,
        options.time,
        options.rate,
        frames,
        numbers,
        options.split,
        options.unit,
        options.time_unit,
        options.orientation,
    )
    text = task_text(options.name, options.base_frame, list(frames))
    task = Task.from_text(text, "the task file")
    shown = _read(options.files, columns)
    there = [path for path in [options.to / TASK_FILE, *(options.to / name for name in shown)] if path.exists()]
    if there:
        raise ConversionError(
            f"{listed(map(str, there))} exists, and is not overwritten: move it, or name another folder"
        )
    with progress_bar(total=len(shown), desc="writing bags", unit="bag") as bar:
        for name, one in shown.items():
            try:
                bag = write_bag(options.to / name, one.ns, topics_of(one), options.base_frame, one.numbers)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(options.to / name)) from error
            counts = audit(bag, one, options.base_frame)
            period = float(np.median(np.diff(one.ns))) * 1e-9
            report["bags"].append(
                {
                    "bag": str(bag),
                    "samples": len(one.ns),
                    "duration_s": 1e-9 * float(one.ns[-1]),
                    "rate_hz": 1.0 / period,
                    "extent_m": float(np.linalg.norm(np.ptp(one.movement[:, :3], axis=0))),
                    "messages": counts,
                    "notes": list(one.notes),
                }
            )
            bar.update()
    write_atomically(options.to / TASK_FILE, lambda file: file.write_text(text))
    report["task_file"] = str(options.to / TASK_FILE)
    recordings, bad = read_recordings([options.to / name for name in shown], task)
    report["notes"] = [f"{one.place}: {note}" for one in recordings for note in one.notes]
    report["bad_bags"] = [{"bag": str(error.path), "error": str(error)} for error in bad]
    report["doubts"] = [asdict(doubt) for doubt in doubts_about(recordings, task)] if recordings else []


def _check_names(options: argparse.Namespace, frames: dict[str, str], numbers: dict[str, str]) -> None:
    """Refuse what cannot be written into a task file, or would be there twice."""
    if not is_name(options.name):
        raise ConversionError(f"--name {options.name!r} is no name of letters, digits and underscores")
    if BEGIN in frames:
        raise ConversionError(f"--frame {BEGIN}: this is where the hand is at the beginning; take another name")
    if taken := next((name for name in frames if topic_of(name) == MOVEMENT), None):
        raise ConversionError(f"--frame {taken}: this is the movement, of which --movement tells; take another name")
    if twice := sorted({MOVEMENT, *map(topic_of, frames)} & numbers.keys()):
        raise ConversionError(f"--number {twice[0]}: this is the topic of poses; give the number another topic")
    refuse_foreign(options.to / TASK_FILE, b"", "task file")


def _read(files: Sequence[Path], columns: Columns) -> dict[str, Shown]:
    """Demonstrations by the names of their bags."""
    found: dict[str, Shown] = {}
    for file in files:
        try:
            several = [
                replace(one, notes=(*notes, *one.notes))
                for table, notes in _tables(file, columns)
                for one in demonstrations_of(table, columns)
            ]
        except ConversionError as error:
            text = str(error)
            raise ConversionError(text if text.startswith(str(file)) else f"{file}: {text}") from None
        digits = max(2, len(str(len(several))))
        for number, one in enumerate(several, 1):
            stem = file.resolve().name if file.is_dir() else file.stem
            name = stem if len(several) == 1 else f"{stem}_{number:0{digits}d}"
            if name in found:
                raise ConversionError(
                    f"{file}: its bag would have the name {name}, like that of another file; rename one of the files"
                )
            found[name] = one
    return found


def _tables(file: Path, columns: Columns) -> list[tuple[Table, tuple[str, ...]]]:
    if is_dataset(file):
        return [(episode.table, episode.notes) for episode in read_dataset(file, columns.arrays() - {TIME})]
    return [(table, ()) for table in read_tables(file, columns.arrays(), labels=columns.split)]


def _named(option: str, texts: Sequence[str], is_right: Callable[[str], bool]) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        name, equals, columns = text.partition("=")
        if not equals or not columns or not is_right(name):
            kind = (
                "TOPIC=COLUMN with a relative topic such as gripper/width" if option == "--number" else "NAME=COLUMNS"
            )
            raise ConversionError(f"{option} {text!r} is not {kind}: letters, digits and underscores")
        if name in found:
            raise ConversionError(f"{option} gives {name!r} twice: take another name for one of them")
        found[name] = columns
    return found


def _text(report: dict[str, Any]) -> str:
    rows = [
        (bag["bag"], bag["samples"], f"{bag['duration_s']:.2f}", f"{bag['rate_hz']:.4g}", f"{bag['extent_m']:.3g}")
        for bag in report["bags"]
    ]
    parts = [format_table(("bag", "samples", "s", "Hz", "extent m"), rows)] if rows else []
    parts += dict.fromkeys(one_line(note) for bag in report["bags"] for note in bag["notes"])
    parts += [one_line(note) for note in report.get("notes", [])]
    parts += [f"{'refused' if one['refuses'] else 'doubt'}: {Doubt(**one)}" for one in report.get("doubts", [])]
    parts += [f"bad bag: {one_line(bag['error'])}" for bag in report.get("bad_bags", [])]
    if report["passed"]:
        where = f"the dataset {report['dataset']} holds" if "dataset" in report else "every bag holds"
        parts.append(f"read back: {where} the same numbers, bit by bit")
        parts += [f"task file: {report['task_file']}"] if "task_file" in report else []
    return "\n\n".join(parts)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="convert",
        description="Convert arrays from other programs to bags, one for each demonstration, with a task file for "
        "them; or bags to a LeRobot dataset.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        type=a_path,
        help=".csv, .tsv, .txt, .npy, .npz, .mat, or the folder of a LeRobot dataset; with --lerobot bags, or folders "
        "of them",
    )
    parser.add_argument(
        "--to", required=True, type=a_path, metavar="FOLDER", help="folder of the bags and task.yaml, or of the dataset"
    )
    parser.add_argument("--lerobot", action="store_true", help="write one LeRobot dataset (v3.0) from bags")
    parser.add_argument(
        "--task",
        type=a_path,
        metavar="TASK_FILE",
        help="task file of the bags, with --lerobot; its name becomes that of the task",
    )
    parser.add_argument(
        "--movement",
        metavar="COLUMNS",
        help="poses of the hand: names separated by commas, an array, or columns of one by number, such as poses[0:7]; "
        "2 (x, y), 3, 7 (with a quaternion), 6 (see --orientation), 12 or 16 (3 by 4 or 4 by 4 transforms) of them",
    )
    parser.add_argument(
        "--time",
        metavar="COLUMN",
        help="times of the samples; two columns are seconds and nanoseconds, as in ROS (a LeRobot dataset has its own)",
    )
    parser.add_argument(
        "--rate",
        type=number_above_0("a rate in Hz"),
        metavar="HZ",
        help="samples per second, if there are no times; with --lerobot a whole number (default: that of the bags)",
    )
    parser.add_argument(
        "--frame",
        action="append",
        default=[],
        metavar="NAME=COLUMNS",
        help="poses of a task frame; one pose is constant, rows that are not finite mean not seen; may be repeated",
    )
    parser.add_argument(
        "--number",
        action="append",
        default=[],
        metavar="TOPIC=COLUMN",
        help="another number, such as a gripper's width, as std_msgs/Float64; may be repeated",
    )
    parser.add_argument("--split", metavar="COLUMN", help="a demonstration begins where this number or text changes")
    parser.add_argument("--unit", choices=UNITS, default="m", help="unit of positions (default: m)")
    parser.add_argument("--time-unit", choices=TIME_UNITS, default="s", help="unit of times (default: s)")
    parser.add_argument(
        "--orientation", choices=ORIENTATIONS, default="xyzw", help="how orientations are written, angles in rad"
    )
    parser.add_argument("--base-frame", default="base", help="frame of all poses (default: base)")
    parser.add_argument("--name", default="converted", help="name of the task (default: converted)")
    parser.add_argument("--json", action="store_true", help="print everything that was found as JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
