# SPDX-License-Identifier: Apache-2.0
"""Every executable, given a file that is none of what it needs, ends with status 1 and one line that names the file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from forked_processes import run_all
from ros_graph import ROBOT_FILE, ROOT, TASK_FILE, ros_arguments

BAGS = ROOT / "bags" / "pick_place"
AUTOSTART: dict[str, object] = {"autostart": True}
TASK_FILES: dict[str, object] = {"task_files": f"[{ROOT / 'config' / 'hold_cup.yaml'}]"}

type Arguments = Callable[[str], list[str]]


def node(parameter: str, **others: object) -> Arguments:
    is_list = parameter.endswith("_files")
    return lambda path: ros_arguments(**{**others, parameter: f"[{path}]" if is_list else path})


def program(*arguments: str) -> Arguments:
    """`FILE` stands for the file."""
    return lambda path: [path if argument == "FILE" else argument for argument in arguments]


#: By executable and what the file is for there: arguments that are good otherwise.
FILES: dict[str, dict[str, Arguments]] = {
    "frame_tracker": {"task_file": node("task_file")},
    "reproduction": {
        "task_file": node("task_file", **AUTOSTART),
        "model_file": node("model_file", task_file=TASK_FILE, **AUTOSTART),
    },
    "impedance_controller": {"robot_file": node("robot_file", **AUTOSTART)},
    "joint_motion": {"robot_file": node("robot_file", **AUTOSTART)},
    "joint_reference": {
        "robot_file": node("robot_file"),
        "task_files": node("task_files", robot_file=ROBOT_FILE, model_files="[none.tpgmm]"),
        "model_files": node("model_files", robot_file=ROBOT_FILE, **TASK_FILES),
    },
    "baxter_simulator": {"robot_file": node("robot_file")},
    "endpoint_poses": {"robot_file": node("robot_file")},
    "check_robot": {"robot": program("FILE")},
    "inspect": {
        "task": program("--task", "FILE", str(BAGS)),
        "bag": program("FILE"),
    },
    "train": {
        "task": program("--task", "FILE", "--output", "model.tpgmm", str(BAGS)),
        "bag": program("--task", str(TASK_FILE), "--output", "model.tpgmm", "FILE"),
    },
    "teach": {
        "task": program("--task", "FILE", "--output", "bag"),
        "scripted task": program("--scripted", "--task", "FILE", "--output", "bag"),
        "robot": program("--scripted", "--robot", "FILE", "--output", "bag"),
    },
    "demo": {
        "task": program("--task", "FILE", "--model", "none.tpgmm"),
        "task to train for": program("--task", "FILE", "--bags", str(BAGS)),
        "robot": program("--robot", "FILE", "--model", "none.tpgmm"),
        "model": program("--model", "FILE"),
        "bags": program("--bags", "FILE"),
    },
    "figure5": {"robot": program("--robot", "FILE"), "bags": program("--bags", "FILE")},
}
#: What is asked without a file that could be missing: nodes need a task or a robot file, programs a positional argument
#: or an option; demo and figure5 work without any.
WITHOUT_ARGUMENTS = {
    **dict.fromkeys(("check_robot", "inspect", "train", "teach"), 2),
    **dict.fromkeys(("frame_tracker", "joint_reference", "baxter_simulator", "endpoint_poses"), 1),
}


UNKNOWN = {"an unknown option": ["--no-such-option"], "an unknown option behind words": ["a", "b", "--no-such-option"]}


def wrong_files(folder: Path, ending: str) -> list[Path]:
    """None of them is a task, a robot, a model or a bag."""
    names = ("missing", "directory", "empty", "binary", "text", "unreadable")
    missing, directory, empty, binary, text, unreadable = files = [folder / f"{name}.{ending}" for name in names]
    directory.mkdir(parents=True)
    empty.touch()
    binary.write_bytes(bytes(range(256)) * 40)
    text.write_text("the quick brown fox: [\n")
    # For root too, who may read all files: nothing is at its first address
    unreadable.symlink_to("/proc/self/mem")
    assert not missing.exists()
    return files


@dataclass(frozen=True, slots=True)
class Case:
    """An executable with arguments, what is tried, and the file that its error has to name."""

    name: str
    what: str
    arguments: list[str]
    statuses: tuple[int, ...]
    named: str = ""


def cases_in(folder: Path) -> list[Case]:
    cases = []
    for name, places in FILES.items():
        cases += [Case(name, what, arguments, (2,)) for what, arguments in UNKNOWN.items()]
        if name in WITHOUT_ARGUMENTS:
            cases.append(Case(name, "no arguments", [], (WITHOUT_ARGUMENTS[name],)))
        for what, arguments in places.items():
            for file in wrong_files(folder / name / what, "mcap" if what == "bag" else "yaml"):
                cases.append(Case(name, f"{what}: {file.name}", arguments(str(file)), (1, 2), str(file)))
    return cases


@pytest.fixture(scope="module")
def answers(module_domain: int, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Case, int, str, str]]:
    folder = tmp_path_factory.mktemp("misuse")
    cases = cases_in(folder)
    with contextlib.chdir(folder):
        ended = run_all([[case.name, *case.arguments] for case in cases])
    return [(case, one.returncode, one.stdout, one.stderr) for case, one in zip(cases, ended, strict=True)]


@pytest.mark.parametrize("name", FILES)
def test_misuse_ends_an_executable_with_one_line_that_says_what_is_wrong_and_names_the_file(
    name: str, answers: list[tuple[Case, int, str, str]]
) -> None:
    bad = []
    for case, status, output, errors in answers:
        lines = [line for line in errors.splitlines() if line.startswith(("error: ", f"{name}: error: ", "bad bag: "))]
        said = any(case.named in line for line in lines) and max(map(len, lines)) < 1000
        if case.name == name and (status not in case.statuses or not said or "Traceback" in errors + output):
            bad.append(f"{case.what}: status {status}\n{output}{errors}")
    assert not bad, "\n".join(bad)
