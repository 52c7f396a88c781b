# SPDX-License-Identifier: Apache-2.0
"""Put faults into a copy of the sources, one at a time, and see whether the tests notice: `make mutants`.

    .venv/bin/python tools/mutants.py [--only TEXT] [--list FILE] [--output DIRECTORY]

The list (tools/mutants.yaml) names for each fault a file, a text in it, what stands there instead, and the tests that
have to fail then. A fault that no test notices, a text that is not found, or is there more than once, and a test that
fails without any fault: each makes the exit status 1. The working tree is not touched: the copy lies elsewhere. What
the tests printed is in DIRECTORY, a file for each fault.

Compiled functions keep what they were compiled from, also where a function of another file has changed. So the copy
loses, for as long as a fault is in, what was compiled from the file and from all that import it.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml

from tpgmm_core.common.report import Row, format_rows, write_json

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("src", "test", "benchmarks", "examples", "tools", "docs", "bags", "config", "conftest.py", "pyproject.toml",
          "README.md", "Makefile")  # fmt: skip
PACKAGES = ("src/tpgmm_core", "src/tpgmm_ros", "src/tpgmm_demos", "src/tpgmm_workbench")
#: A fault may make a program wait for ever: a test counts as failed after this time and that of all tests without a
#: fault, s, which is long where other programs take the cores
TIMEOUT = 300.0
#: Of all tests without a fault, s
MOST = 3600.0
#: Of pytest: tests failed, or could not even be collected
FAILED = (1, 2)


@dataclass(frozen=True, slots=True)
class Mutant:
    """One fault.

    Parameters
    ----------
    file
        from the root of the repository
    original
        a text that is in it once; of several lines, each is indented by as much more as the first
    fault
        what stands there instead
    tests
        arguments of pytest
    """

    file: str
    original: str
    fault: str
    tests: tuple[str, ...]

    def faulty(self, source: str) -> str:
        """The source with the fault in it.

        Raises
        ------
        ValueError
            where the text is not in the source, or several times
        """
        lines = [re.escape(line) for line in self.original.splitlines()]
        pattern = "^( *)" + r"\n\1".join(lines) if len(lines) > 1 else f"(){lines[0]}"
        found = list(re.finditer(pattern, source, re.MULTILINE))
        if len(found) != 1:
            raise ValueError(f"the text is there {len(found)} times, expected once")
        fault = "\n".join(found[0][1] + line for line in self.fault.splitlines())
        return source[: found[0].start()] + fault + source[found[0].end() :]


def read_list(path: Path) -> list[Mutant]:
    """The faults of a list."""
    found = []
    for file, items in yaml.safe_load(path.read_text()).items():
        for item in items:
            tests = [item["tests"]] if isinstance(item["tests"], str) else item["tests"]
            found.append(Mutant(file, item["original"], item["fault"], tuple(tests)))
    return found


class Tree:
    """A copy of the sources, with times of files, so that what is compiled stays valid.

    Parameters
    ----------
    root
        the working tree
    directory
        of the copy, which does not exist
    """

    def __init__(self, root: Path, directory: Path) -> None:
        directory.mkdir(parents=True)
        self.path = directory
        for name in COPIED:
            source = root / name
            if source.is_symlink():
                (directory / name).symlink_to(os.readlink(source))
            elif source.is_dir():
                shutil.copytree(source, directory / name, symlinks=True)
            elif source.exists():
                shutil.copy2(source, directory / name)
        (directory / ".venv").symlink_to(Path(sys.prefix))
        # what lies beside the repository is found beside the copy too
        if (root.parent / "shared").is_dir():
            (directory.parent / "shared").symlink_to(root.parent / "shared")
        self._imports = {
            path: _imports(path)
            for package in map(Path, PACKAGES)
            for path in (directory / package / package.name).rglob("*.py")
        }

    @contextmanager
    def with_fault(self, mutant: Mutant) -> Iterator[None]:
        """The copy while it has a fault.

        Raises
        ------
        ValueError
            where the text is not in the file once
        """
        path = self.path / mutant.file
        aside = self.path.parent / "aside"
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir()
        text = mutant.faulty(path.read_text())
        kept = [(cache, aside / f"{i}") for i, cache in enumerate(self._compiled_from(path))]
        shutil.copy2(path, aside / "source")
        for cache, place in kept:
            cache.rename(place)
        path.write_text(text)
        try:
            yield
        finally:
            shutil.copy2(aside / "source", path)
            for cache in self._compiled_from(path):
                cache.unlink()
            for cache, place in kept:
                place.rename(cache)

    def test(self, tests: Sequence[str], limit: float) -> tuple[int, str]:
        """Run tests in the copy for at most `limit` s: the status of pytest, and what it printed."""
        paths = ":".join(str(self.path / package) for package in PACKAGES)
        # Without compiled files: within a second, those of another fault of the same length would be taken for its own
        environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider", *tests]
        try:
            run = subprocess.run(
                command, cwd=self.path, env=environment, timeout=limit,
                capture_output=True, text=True,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            return 1, f"not done in {limit:.0f} s\n{error.stdout!r}"
        return run.returncode, run.stdout + run.stderr

    def _compiled_from(self, path: Path) -> list[Path]:
        """What numba keeps of a file and of all that import it, directly or not."""
        dependent, new = {path}, {path}
        while new:
            names = {_module(one) for one in new}
            new = {other for other, imported in self._imports.items() if imported & names} - dependent
            dependent |= new
        return [cache for one in dependent for cache in (one.parent / "__pycache__").glob(f"{one.stem}.*.nb[ic]")]


def _module(path: Path) -> str:
    parts = path.with_suffix("").parts
    first = max(i for i, part in enumerate(parts) if part.startswith("tpgmm_") and parts[i - 2] == "src")
    return ".".join(parts[first:]).removesuffix(".__init__")


def _imports(path: Path) -> set[str]:
    """Names of modules that a file imports; `from a import b` may mean both a and a.b."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def run(mutants: Sequence[Mutant], root: Path, output: Path) -> list[Row]:
    """Try all faults.

    Parameters
    ----------
    mutants
        the faults
    root
        the working tree
    output
        directory for what the tests print

    Returns
    -------
    list[Row]
        file, fault, what happened ("killed" is good), s; the first row is that of all tests without a fault
    """
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="mutants-") as directory:
        return _try_all(mutants, Tree(root, Path(directory) / "tree"), output)


def _try_all(mutants: Sequence[Mutant], tree: Tree, output: Path) -> list[Row]:
    begin = time.monotonic()
    status, printed = tree.test(sorted({test for mutant in mutants for test in mutant.tests}), MOST)
    limit = TIMEOUT + time.monotonic() - begin
    rows: list[Row] = [_row("all tests", "no fault", "passed" if status == 0 else "FAILED", begin)]
    (output / "no_fault.txt").write_text(printed)
    print(_line(rows[-1], 0, len(mutants)), flush=True)
    for i, mutant in enumerate(mutants, start=1):
        begin = time.monotonic()
        try:
            with tree.with_fault(mutant):
                status, printed = tree.test(mutant.tests, limit)
            (output / f"{i:03d}.txt").write_text(f"{mutant}\n{printed}")
            verdict = "killed" if status in FAILED else "SURVIVED" if status == 0 else f"pytest ended with {status}"
        except (ValueError, FileNotFoundError) as error:
            verdict = f"NOT FOUND: {error}"
        rows.append(_row(mutant.file, " ".join(mutant.fault.split()), verdict, begin))
        print(_line(rows[-1], i, len(mutants)), flush=True)
    return rows


def _row(file: str, fault: str, verdict: str, begin: float) -> Row:
    return {"file": file, "fault": fault, "verdict": verdict, "s": round(time.monotonic() - begin, 1)}


def _line(row: Row, i: int, count: int) -> str:
    return f"  {i:3d} of {count}  {row['s']:5.1f} s  {row['verdict']}: {row['file']}: {row['fault']}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", type=Path, default=ROOT / "tools" / "mutants.yaml", help="(default: %(default)s)")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults whose file or text contains this")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "mutants", help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    chosen = [m for m in read_list(options.list) if options.only in m.file or options.only in m.original]
    if not chosen:
        parser.error(f"no fault of {options.list} contains {options.only!r}")
    rows = run(chosen, ROOT, options.output.resolve())
    good = [row for row in rows if row["verdict"] in ("killed", "passed")]
    print(f"\n{format_rows([row for row in rows if row not in good] or rows[:1])}")
    write_json(options.output / "report.json", {"passed": len(good) == len(rows), "rows": rows})
    print(f"{len(good) - (rows[0] in good)} of {len(chosen)} faults noticed; report: {options.output / 'report.json'}")
    return 0 if len(good) == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
