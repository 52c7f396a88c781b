# SPDX-License-Identifier: Apache-2.0
"""What the pages name is there: links, pictures, commands and their options, functions; what is made is up to date."""

from __future__ import annotations

import ast
import contextlib
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from forked_processes import entry_points, run_all
from ros_testing import StartProcess, executable

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
#: The page with the commands that train a model and start the nodes, and the program that asks them.
NODES_PAGE = DOCS / "how-to" / "run-the-nodes.md"
PAGES = sorted([ROOT / "README.md", ROOT / "bags" / "README.md", *DOCS.rglob("*.md")])
#: Rows that `make reference` writes are not commands of a page's own, but what programs say of themselves.
COMMAND_PAGES = [path for path in PAGES if path != DOCS / "reference" / "programs.md"]
LINK = re.compile(r"(!?)\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^()\s#]*)(?:#([^()\s]*))?\)")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def prose(path: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^( *)```.*?^\1```", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)


# -- links


@cache
def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and the site make them."""
    found = set()
    for heading in re.findall(r"^#+ +(.*)$", prose(path), re.MULTILINE):
        words = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", heading).lower().replace("`", "")
        found.add(re.sub(r"[^\w\- ]", "", words).strip().replace(" ", "-"))
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_and_pictures_lead_somewhere(page: Path) -> None:
    for picture, target, anchor in LINK.findall(prose(page)):
        if "://" in target:
            continue
        path = Path(os.path.normpath(page.parent / target)) if target else page
        assert path.exists(), f"{name_of(page)}: {target}"
        assert path.is_relative_to(ROOT), f"{name_of(page)}: {target}"
        if picture:
            assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n", target
        elif anchor:
            assert anchor in anchors(path), f"{name_of(page)}: {target}#{anchor}; there are {sorted(anchors(path))}"


def test_every_page_can_be_reached_from_the_index_and_the_index_from_the_readme() -> None:
    def linked(page: Path) -> set[Path]:
        targets = (
            target for _, target, _ in LINK.findall(prose(page)) if target.endswith(".md") and "://" not in target
        )
        return {Path(os.path.normpath(page.parent / target)) for target in targets}

    found: set[Path] = set()
    left = {DOCS / "index.md"}
    while left:
        found |= left
        left = {page for known in left for page in linked(known)} - found
    assert set(DOCS.rglob("*.md")) <= found
    assert DOCS / "index.md" in linked(ROOT / "README.md")
    assert DOCS / "tutorials" / "first-movement.md" in linked(ROOT / "README.md")


# -- commands


def commands(page: Path) -> Iterator[list[str]]:
    """The command lines of a page, as words: of `sh` blocks, of indented ones and of code within a sentence."""
    text = page.read_text()
    blocks = re.findall(r"^ *```sh\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    blocks += re.findall(r"(?:(?<=\n\n)|^)((?:    .*\n)+)", re.sub(r"^ *```.*?^ *```", "", text, flags=re.S | re.M))
    blocks += re.findall(r"(?<!`)`([^`\n]+)`(?!`)", prose(page))
    for block in blocks:
        for line in re.sub(r"\\\n", " ", block).splitlines():
            try:
                words = shlex.split(re.sub(r"(?:^|\s)# .*", "", line))  # task.yaml#left is no comment
            except ValueError:
                continue  # output of a program, with a quotation mark
            while words and re.fullmatch(r"[A-Z_0-9]+=\S*", words[0]):
                words.pop(0)
            if words:
                yield words


@cache
def help_of(name: str) -> str:
    """What an executable of ours, or a script or module of Python, says of its arguments."""
    places = [ROOT, ROOT / "src" / "tpgmm_core" / "test", ROOT / "test", os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, places))}
    with contextlib.chdir(ROOT):
        (asked,) = run_all([[name, "--help"]], environment=environment)
    assert asked.returncode == 0, f"{name} --help: {asked.stderr}"
    return asked.stdout


def program_of(words: list[str]) -> tuple[str, list[str]] | None:
    """The program of ours that a command runs, and its arguments; None for those of others."""
    first, *rest = words
    if found := re.fullmatch(r"\.venv/lib/tpgmm_(?:ros|demos)/(\w+)", first):
        return found[1], rest
    if words[:3] == ["ros2", "run", "tpgmm_ros"] and words[3:] and words[3].isidentifier():
        return words[3], words[4:]
    if first in ("train", "inspect", "teach", "demo", "check_robot", "figure5", "scripted_lessons"):
        return first, rest
    if Path(first).name in ("python", "python3") and rest:
        if rest[0] == "-m" and rest[1].startswith(("tpgmm", "benchmarks", "faults")):
            return rest[1], rest[2:]
        if (ROOT / rest[0]).suffix == ".py" and "/" in rest[0]:
            return rest[0], rest[1:]
    return None


def targets() -> dict[str, str]:
    """The targets of `make` that its help lists, and what it says of them."""
    return dict(re.findall(r"^([a-z0-9]+):.*## (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("page", COMMAND_PAGES, ids=name_of)
def test_commands_name_targets_programs_options_and_parameters_that_exist(page: Path) -> None:
    """A script's own `--help` decides on its options. Those that only start long work have none and take none."""
    for words in commands(page):
        line = shlex.join(words)
        if words[0] == "make" and len(words) > 1 and re.fullmatch(r"[a-z0-9]+", words[1]):
            assert words[1] in targets(), line
        if not (program := program_of(words)):
            continue
        name, arguments = program
        if not name.endswith(".py"):
            assert name in entry_points() or "." in name or name == "faults", f"{name_of(page)}: {line}"
        else:
            assert (ROOT / name).exists(), f"{name_of(page)}: {line}"
        own, _, of_ros = (" ".join(arguments) + " ").partition("--ros-args")
        options = re.findall(r"(?<=\s)(--[a-z][\w-]*)", f" {own}")
        parameters = re.findall(r"-p (\w+):=", of_ros)
        if not options and not parameters:
            continue
        said = help_of(name)
        for option in options:
            assert re.search(rf"(?<![\w-]){option}(?![\w-])", said), f"{name_of(page)}: {line}: no {option}"
        for parameter in parameters:
            assert re.search(rf"^  {parameter}: ", said, re.MULTILINE), f"{name_of(page)}: {line}: no {parameter}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_targets_and_files_named_in_the_text_exist(page: Path) -> None:
    text = page.read_text()
    for target in re.findall(r"`make ([a-z0-9]+)", text):
        assert target in targets(), target
    for path in re.findall(r"`((?:config|bags|benchmarks|examples|tools|src|docs|test)/[\w./-]+)`", text):
        made_elsewhere = path.startswith("bags/mine")
        assert made_elsewhere or list(ROOT.glob(path)), f"{name_of(page)}: {path}"


def test_every_target_is_on_a_page() -> None:
    """`make help` and the README list the same targets."""
    readme = (ROOT / "README.md").read_text()
    named = set(re.findall(r"`([a-z0-9]+)`", readme)) | set(re.findall(r"make ([a-z0-9]+)", readme))
    assert not targets().keys() - named


# -- examples


def snippets(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE)


def printed_after(path: Path, snippet: str) -> str:
    """The indented block of output that follows a snippet, or the command that runs it."""
    rest = path.read_text().split(snippet, 1)[1].split("```\n", 1)[1]
    rest = re.sub(r"\A\s*```sh\n.*?```\n", "", rest, flags=re.DOTALL)
    block = re.match(r"\s*\n((?:    .*\n)+)", rest)
    return "" if block is None else re.sub(r"^    ", "", block[1], flags=re.MULTILINE)


def run_snippet(path: Path, snippet: str, names: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    """Run it; it prints what the page shows."""
    capsys.readouterr()
    exec(compile(snippet, str(path), "exec"), names)
    assert capsys.readouterr().out == printed_after(path, snippet)


def test_the_tutorial_in_python_prints_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page, names = DOCS / "tutorials" / "planar-model.md", dict[str, Any]()
    assert len(snippets(page)) == 4
    for snippet in snippets(page):
        run_snippet(page, snippet, names, capsys)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder with the model that the command of NODES_PAGE trains, and what the command prints."""
    folder = tmp_path_factory.mktemp("trained")
    (words,) = (words for words in commands(NODES_PAGE) if words[0] == ".venv/lib/tpgmm_ros/train")
    words = [str(ROOT / word) if word.startswith(("config/", "bags/")) else word for word in words]
    run = subprocess.run([executable("train"), *words[1:]], cwd=folder, capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, run.stderr
    return folder, run.stdout


def test_the_first_tutorial_trains_the_model_that_its_program_asks(
    trained: tuple[Path, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The demonstration itself is `test_demo.py`; here are the command that trains and the program that asks."""
    page = DOCS / "tutorials" / "first-movement.md"
    folder, printed = trained
    of_nodes_page = [words for words in commands(NODES_PAGE) if words[0] == ".venv/lib/tpgmm_ros/train"]
    assert [words for words in commands(page) if Path(words[0]).name == "train"] == of_nodes_page
    shown = re.search(r"^    what +value\n((?:    .*\n)+)", page.read_text(), re.MULTILINE)
    assert shown is not None
    for line in shown[1].splitlines():
        assert line.strip() == "..." or line.strip() in printed, line
    monkeypatch.chdir(folder)
    (snippet,) = snippets(page)
    run_snippet(page, snippet, {}, capsys)


def test_the_readme_example_without_ros_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    examples = snippets(ROOT / "README.md")
    assert examples
    for text in examples:
        exec(compile(text, "README.md", "exec"), {})


def test_the_nodes_of_the_page_and_its_program_reach_the_end_of_the_movement(
    trained: tuple[Path, str], start_process: StartProcess
) -> None:
    """As they stand, but on simulated time, so that a busy machine only takes longer."""
    folder, _ = trained
    further = {
        "baxter_simulator": ["-p", "lockstep:=true", "-p", "rate:=250.0", "-p", "physics_steps:=4"],
        "frame_tracker": ["-p", "use_sim_time:=true"],
        "impedance_controller": ["-p", "use_sim_time:=true"],
        "reproduction": ["-p", "use_sim_time:=true"],
    }
    nodes = [words for words in commands(NODES_PAGE) if "--ros-args" in words and words[0] != "ros2"]
    assert [Path(words[0]).name for words in nodes] == list(further)
    for words in nodes:
        arguments = [word.replace(":=config/", f":={ROOT}/config/") for word in words[1:]]
        arguments = [word.replace(":=pick_place.tpgmm", f":={folder}/pick_place.tpgmm") for word in arguments]
        name = Path(words[0]).name
        start_process(name, *arguments, *further[name])
    (program,) = snippets(NODES_PAGE)
    (folder / "reproduce.py").write_text(program)
    asked = start_process(sys.executable, str(folder / "reproduce.py"), "--ros-args", "-p", "use_sim_time:=true")
    assert asked.wait(240.0) == 0, asked.output
    assert re.search(r"^reached: \d\.\d mm and \d\.\d deg from the model's end", asked.output, re.MULTILINE), (
        asked.output
    )
    assert re.match(r"reached: \d\.\d mm and \d\.\d deg", printed_after(NODES_PAGE, program))


def test_every_benchmark_answers_help() -> None:
    """Not by running for minutes."""
    programs = [path for path in (ROOT / "benchmarks").glob("*.py") if "__main__" in path.read_text()]
    assert len(programs) > 30
    for path in programs:
        if path.name != "networks_camera.py":  # a host that `networks.py` starts
            assert re.search(r"ArgumentParser\(|without_options\(__doc__\)", path.read_text()), path.name


# -- from the paper to the code


@cache
def definitions() -> set[str]:
    """Classes, functions, methods and tests of the project, by name and as `Class.method`; scripts by file name."""
    found = set()
    for folder in ("src", "test", "benchmarks", "examples"):
        for path in (ROOT / folder).rglob("*.py"):
            found.add(path.name)
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ClassDef | ast.FunctionDef):
                    found.add(node.name)
                if isinstance(node, ast.ClassDef):
                    found |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return found


def test_the_map_from_the_paper_names_functions_and_tests_that_exist() -> None:
    rows = [
        [re.findall(r"`([^`]+)`", cell) for cell in line.strip("|").split("|")]
        for line in (DOCS / "reference" / "paper.md").read_text().splitlines()
        if line.startswith("| ") and "`" in line
    ]
    assert len(rows) > 30
    for _, _, functions, tests, *_ in rows:
        assert functions and tests and all(name.startswith("test_") for name in tests), (functions, tests)
        assert not {*functions, *tests} - definitions()


def test_the_map_from_the_paper_has_every_equation_and_every_figure() -> None:
    text = (DOCS / "reference" / "paper.md").read_text()
    cells = re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE)
    equations = {int(number) for cell in cells for number in re.findall(r"\((\d+)\)", cell)}
    assert equations == set(range(1, 13))
    figures = text[text.index("## Figures") : text.index("## Sections")]
    shown = re.findall(r"^\| (\d) .* \[.*\]\((\S+\.png)\) \|$", figures, re.MULTILINE)
    assert {number for number, _ in shown} == set("123456")
    pictures = re.findall(r"\]\((\S+\.png)\)", text)
    assert all((DOCS / "reference" / picture).is_file() for picture in pictures)


def test_the_map_from_the_paper_has_every_section_and_nothing_is_partly_there() -> None:
    text = (DOCS / "reference" / "paper.md").read_text()
    sections = re.findall(r"^\| (\d) \|", text[text.index("## Sections") :], re.MULTILINE)
    assert set(sections) == set("1234567") and sections == sorted(sections)
    assert not re.search("partly|partial|not yet|missing:", text)


# -- walks through the code


def defined_in(path: Path) -> set[str]:
    """Functions and classes of a file, and methods as `Class.method`."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return found


def test_each_hop_of_the_walks_is_a_function_in_its_file() -> None:
    text = (DOCS / "architecture.md").read_text()
    section = re.search(r"^## Four walks through the code\n(.*?)^## ", text, re.MULTILINE | re.DOTALL)
    assert section is not None
    walks = re.split(r"^### ", section[1], flags=re.MULTILINE)[1:]
    assert len(walks) == 4
    for walk in walks:
        lines = re.findall(r"^\d+\. .*$", walk, re.MULTILINE)
        hops = re.findall(r"^(\d+)\. `([\w/]+\.py)` `([\w.]+)`: \S", walk, re.MULTILINE)
        assert len(hops) == len(lines) > 10
        assert [int(number) for number, _, _ in hops] == list(range(1, len(hops) + 1))
        assert len(set(hops)) == len(hops)
        for _, file, name in hops:
            (path,) = (ROOT / "src").glob(f"tpgmm_*/tpgmm_*/{file}")
            assert name in defined_in(path), f"{file} has no {name}"


# -- pages that are made


def test_the_pages_that_are_made_say_what_the_sources_say(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "tools" / "reference_pages.py"), "--check"]
    environment = {**os.environ, "ROS_LOG_DIR": str(tmp_path)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=250)
    assert run.returncode == 0, run.stdout + run.stderr
