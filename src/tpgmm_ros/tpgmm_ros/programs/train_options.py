# SPDX-License-Identifier: Apache-2.0
"""The arguments of `train`."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.text import one_line
from tpgmm_core.retrieval.methods import ALL_METHODS
from tpgmm_ros.programs.reporting import PAGE, refuse_foreign
from tpgmm_ros.runtime.arguments import SEED, whole_number
from tpgmm_ros.runtime.entry import a_path

EXAMPLES = """\
examples:
  train --task config/pick_place.yaml --output pick_place.tpgmm bags/
  train --task config/pick_place.yaml --output pick_place.tpgmm --report out/train demo_1 demo_2 demo_3
  train --task config/pick_place.yaml --output pick_place.tpgmm --leave-one-out --report training.html bags/
  train --task config/pick_place.yaml --leave-one-out bags/          (only measures, saves no model)
  train --task config/pick_place.yaml --output best.tpgmm --auto --budget 60s bags/pick_place
  train --task config/pick_place.yaml --output dmp.tpgmm --retrieval dmp bags/
  train --task config/pick_place.yaml --output first.tpgmm --online bags/monday
  train --task config/pick_place.yaml --output better.tpgmm --update first.tpgmm bags/tuesday
  train --task config/pick_place.yaml --output all.tpgmm --one-by-one bags/
  train --task config/pick_place.yaml --output place.tpgmm --bases pick.tpgmm bags/place
  train --task config/pick_place.yaml --output few.tpgmm --components 4 --every 5 --skip-bad bags/

exit status: 0 the model was trained and saved; 1 it was not, the reason is on stderr; 2 wrong arguments;
130 interrupted (with --auto, the best so far is saved then, and the status is 0)
"""


def parser_of_train() -> argparse.ArgumentParser:
    """The parser of all arguments of `train`."""
    parser = argparse.ArgumentParser(
        prog="train",
        description="Train a task-parameterized Gaussian mixture model from recorded demonstrations.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", type=a_path, metavar="FILE", help="where the model is saved, such as task.tpgmm")
    parser.add_argument(
        "--components",
        type=whole_number(1),
        metavar="K",
        help="number of Gaussians, instead of n_components of the task file",
    )
    parser.add_argument(
        "--retrieval",
        type=current_name,
        choices=ALL_METHODS,
        metavar="METHOD",
        help=f"retrieval method of the model, instead of retrieval of the task file: {', '.join(ALL_METHODS)}",
    )
    parser.add_argument(
        "--seed", type=whole_number(0, SEED), help="seed of random choices, instead of random_state of the task file"
    )
    parser.add_argument(
        "--leave-one-out",
        action="store_true",
        help="reproduce each demonstration with a model of the others, and print the errors",
    )
    add_jobs(parser)
    parser.add_argument(
        "--one-by-one",
        action="store_true",
        help="keep only one recording in memory at a time, if they do not all fit; their data are kept in a "
        "temporary folder (TMPDIR), and --jobs processes share each iteration of EM",
    )
    parser.add_argument(
        "--auto",
        action="store_true",
        help="choose frames, method and settings by reproducing demonstrations that were left out; "
        "--retrieval fixes the method",
    )
    parser.add_argument(
        "--budget",
        type=_seconds,
        metavar="TIME",
        help="for --auto: time for the search, such as 60s (the default) or 5min",
    )
    parser.add_argument("--trials", type=whole_number(1), metavar="N", help="for --auto: try at most N configurations")
    parser.add_argument(
        "--workers",
        type=whole_number(1),
        metavar="N",
        help="for --auto: number of processes (default: one for each core)",
    )
    parser.add_argument(
        "--online",
        action="store_true",
        help="learn a model that can be updated with more bags later (--update), without these bags",
    )
    parser.add_argument(
        "--update",
        type=a_path,
        metavar="MODEL",
        help="continue to learn with this model, which was learned with --online, from the BAGs",
    )
    parser.add_argument(
        "--bases",
        type=a_path,
        metavar="MODEL",
        help="take the bases (synergies) of this model, of the same frames and with semi_tied covariances, as they "
        "are, and learn only the variances along them: for few demonstrations of a related task",
    )
    parser.add_argument(
        "--report",
        type=a_path,
        metavar="WHERE",
        help="write a report: FILE.html is a page with pictures, anything else the directory of report.json",
    )
    add_reading_options(parser)
    return parser


def add_jobs(parser: argparse.ArgumentParser) -> None:
    """Add how many processes leave demonstrations out."""
    parser.add_argument(
        "--jobs",
        type=whole_number(1),
        default=1,
        metavar="N",
        help="number of processes for leave-one-out, through joblib (default: 1); the numbers stay the same",
    )


def add_reading_options(parser: argparse.ArgumentParser, nargs: str = "+") -> None:
    """Add which bags are read (`nargs`: how many), by which task file, and how strictly: see `reading.read_bags`."""
    parser.add_argument(
        "bags",
        metavar="BAG",
        nargs=nargs,
        type=a_path,
        help="rosbag2 (MCAP, sqlite3) or ROS 1 bag, or one of its files, or a directory with several of them",
    )
    parser.add_argument(
        "--task", required=True, type=a_path, help="task file: topics, frames and settings of the model"
    )
    parser.add_argument(
        "--every",
        type=whole_number(1),
        default=1,
        metavar="N",
        help="use every N-th sample of the movement (default: all)",
    )
    parser.add_argument(
        "--separate",
        action="store_true",
        help="bags that continue another bag are separate demonstrations, not parts of one recording",
    )
    parser.add_argument(
        "--strict", action="store_true", help="refuse recordings with any problem, instead of printing a warning"
    )
    parser.add_argument("--skip-bad", action="store_true", help="continue with the good bags if some are bad")
    parser.add_argument("-v", "--verbose", action="store_true", help="print the content of each bag")


def page_of(parser: argparse.ArgumentParser, options: argparse.Namespace) -> Path | None:
    """Where the page of a training is to be written, None without one; what would be lost by that is refused.

    Parameters
    ----------
    parser
        ends the program where an argument is wrong
    options
        report, output

    Returns
    -------
    Path or None
        a file that ends with .html
    """
    report: Path | None = options.report
    if report is None:
        return None
    is_page = report.suffix == ".html"
    if not is_page and report.is_file():
        parser.error(f"--report {report} is a file; name a folder, or a file that ends with .html")
    if is_page and options.output is not None and report.resolve() == options.output.resolve():
        parser.error(f"--report and --output are both {report}: one would overwrite the other")
    try:
        refuse_foreign(report if is_page else report / "report.json", PAGE if is_page else b"", "report of a training")
    except (OSError, ValueError) as error:
        parser.error(one_line(error))
    return report if is_page else None


def _seconds(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d*)?)(s|min|)", text.strip())
    if found is None or float(found[1]) == 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not a time such as 60s or 5min")
    return float(found[1]) * (60.0 if found[2] == "min" else 1.0)
