# SPDX-License-Identifier: Apache-2.0
"""`make mutants`: its list fits the sources, and what it says of a fault is so."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


def program() -> ModuleType:
    specification = importlib.util.spec_from_file_location("mutants", ROOT / "tools" / "mutants.py")
    assert specification is not None and specification.loader is not None
    module = sys.modules["mutants"] = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


mutants = program()
LIST = mutants.read_list(ROOT / "tools" / "mutants.yaml")


@pytest.mark.parametrize("mutant", LIST, ids=lambda mutant: f"{Path(mutant.file).name}: {mutant.original[:30]}")
def test_every_fault_of_the_list_can_be_put_in_and_its_tests_exist(mutant: object) -> None:
    source = (ROOT / mutant.file).read_text()  # type: ignore[attr-defined]
    faulty = mutant.faulty(source)  # type: ignore[attr-defined]
    assert faulty != source
    compile(faulty, mutant.file, "exec")  # type: ignore[attr-defined]
    for test in mutant.tests:  # type: ignore[attr-defined]
        path, _, name = test.partition("::")
        assert f"def {name}" in (ROOT / path).read_text()


def test_lines_are_found_at_any_indentation_and_keep_it() -> None:
    mutant = mutants.Mutant("f", "if a:\n    b = 1", "if a:\n    b = 2", ())
    assert mutant.faulty("x\n        if a:\n            b = 1\ny") == "x\n        if a:\n            b = 2\ny"
    assert mutants.Mutant("f", "if a:\n    b = 1", "", ()).faulty("if a:\n    b = 1\ny") == "\ny"
    for source, count in (("if a:\n        b = 1", 0), ("if a:\n    b = 1\nif a:\n    b = 1", 2)):
        with pytest.raises(ValueError, match=f"there {count} times"):
            mutant.faulty(source)


FILE, TESTS = "src/tpgmm_core/tpgmm_core/sums.py", ("test/test_sums.py",)


def sources(root: Path) -> Path:
    """A small tree of a module and its test; the module."""
    package = root / "src" / "tpgmm_core" / "tpgmm_core"
    package.mkdir(parents=True)
    module = package / "sums.py"
    module.write_text("def total(a, b):\n    return a + b\n\n\ndef other(a):\n    return a\n")
    (root / "test").mkdir()
    (root / "test" / "test_sums.py").write_text(
        "import importlib.util, pathlib\n"
        "path = pathlib.Path(__file__).parents[1] / 'src/tpgmm_core/tpgmm_core/sums.py'\n"
        "spec = importlib.util.spec_from_file_location('sums', path)\n"
        "sums = importlib.util.module_from_spec(spec)\nspec.loader.exec_module(sums)\n"
        "def test_total():\n    assert sums.total(1, 2) == 3\n"
    )
    return module


def test_faults_are_killed_survive_or_are_not_found(tmp_path: Path) -> None:
    root = tmp_path / "root"
    module = sources(root)
    faults = (("a + b", "a - b"), ("a + b", "b + a"), ("a * b", "a"), ("return a + b", "return +"))
    rows = mutants.run([mutants.Mutant(FILE, *fault, TESTS) for fault in faults], root, tmp_path / "out")
    verdicts = [row["verdict"] for row in rows]
    assert verdicts[:3] == ["passed", "killed", "SURVIVED"] and verdicts[4] == "killed"
    assert verdicts[3].startswith("NOT FOUND: the text is there 0 times")
    assert "a + b" in module.read_text() and "assert -1 == 3" in (tmp_path / "out" / "001.txt").read_text()


def test_a_fault_that_makes_a_test_wait_for_ever_is_noticed_and_a_slow_machine_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutants, "TIMEOUT", 0.1)  # s: pytest alone takes longer to start
    sources(tmp_path / "root")
    fault = mutants.Mutant(FILE, "    return a + b", "    while True: a = b", TESTS)
    rows = mutants.run([fault], tmp_path / "root", tmp_path / "out")
    assert [row["verdict"] for row in rows] == ["passed", "killed"]
    assert "not done in" in (tmp_path / "out" / "001.txt").read_text()
