# SPDX-License-Identifier: Apache-2.0
"""The set-up: locks that last, lists that hold what they say, and what is the project's own."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
TOOLS = REPOSITORY / "tools"
#: What only developing needs.
DEVELOPING = {"colcon-core", "coverage", "hypothesis", "mypy", "pytest", "ruff", "scikit-learn", "uv"}


def locked(name: str) -> dict[str, str]:
    """Versions by package of a lock."""
    text = (REPOSITORY / name).read_text()
    return dict(re.findall(r"^([a-z0-9.-]+)(?:\[[^\]]*\])?==(\S+)", text, re.MULTILINE))


def wheel(index: Path, name: str, version: str, *metadata: str) -> str:
    """Put a package without code into an index (PEP 503); the hash of its wheel."""
    module = name.replace("-", "_")
    info = f"{module}-{version}.dist-info"
    path = index / name / f"{module}-{version}-py3-none-any.whl"
    path.parent.mkdir(parents=True, exist_ok=True)
    members = {
        f"{info}/METADATA": "\n".join(["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}", *metadata, ""]),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    members[f"{info}/RECORD"] = "".join(f"{member},,\n" for member in [*members, f"{info}/RECORD"])
    with zipfile.ZipFile(path, "w") as archive:
        for member, text in members.items():
            archive.writestr(member, text)
    links = "".join(f'<a href="{file.name}">{file.name}</a>\n' for file in sorted(path.parent.glob("*.whl")))
    (path.parent / "index.html").write_text(f"<!DOCTYPE html><html><body>{links}</body></html>")
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment as `make` makes it, with the pip that Python brings."""
    path = tmp_path_factory.mktemp("environment") / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(path)], check=True, env=bare())
    return path


def bare() -> dict[str, str]:
    """No settings of this machine: neither ours nor pip's."""
    return {"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/"), "PIP_CONFIG_FILE": os.devnull}


def install(environment: Path, lock: Path, index: Path) -> subprocess.CompletedProcess[str]:
    """The set-up's own command, against another index."""
    command = [str(environment / "bin/python"), str(TOOLS / "install_requirements.py"), str(lock)]
    command += ["--index-url", index.as_uri()]
    return subprocess.run(command, env=bare(), capture_output=True, text=True)


def test_a_lock_is_installed_as_it_is_when_its_packages_have_newer_releases(environment: Path, tmp_path: Path) -> None:
    """An extra of a locked package (`coverage[toml]`) has made resolvers look at its newest release, and refuse it."""
    index, versions = tmp_path / "index", locked("requirements-dev.txt")
    needs = {"pytest-cov": ["Requires-Dist: coverage[toml]>=7.10.6", "Requires-Dist: pluggy>=1.2"]}
    lines = []
    for name in ("coverage", "pytest-cov", "pluggy"):
        metadata = ["Provides-Extra: toml"] if name == "coverage" else needs.get(name, [])
        lines.append(f"{name}=={versions[name]} --hash=sha256:{wheel(index, name, versions[name], *metadata)}\n")
        wheel(index, name, "999.0", *metadata)
    lock = tmp_path / "lock.txt"
    lock.write_text("".join(lines))
    run = install(environment, lock, index)
    assert run.returncode == 0, run.stdout + run.stderr
    frozen = subprocess.run(
        [str(environment / "bin/python"), "-m", "pip", "freeze"], env=bare(), capture_output=True, text=True
    )
    for name in ("coverage", "pytest-cov", "pluggy"):
        assert f"{name}=={versions[name]}" in frozen.stdout


def test_a_lock_that_is_not_whole_is_refused_with_what_is_missing(environment: Path, tmp_path: Path) -> None:
    index, lock = tmp_path / "index", tmp_path / "lock.txt"
    digest = wheel(index, "half", "1.0", "Requires-Dist: other-half>=2")
    lock.write_text(f"half==1.0 --hash=sha256:{digest}\n")
    run = install(environment, lock, index)
    assert run.returncode != 0
    assert "other-half" in run.stdout + run.stderr and "make lock" in run.stderr


def test_a_wheel_with_another_hash_is_refused(environment: Path, tmp_path: Path) -> None:
    index, lock = tmp_path / "index", tmp_path / "lock.txt"
    wheel(index, "changed", "1.0")
    lock.write_text(f"changed==1.0 --hash=sha256:{'0' * 64}\n")
    run = install(environment, lock, index)
    assert run.returncode != 0
    assert "HASH" in (run.stdout + run.stderr).upper()


def test_running_needs_nothing_of_what_developing_needs() -> None:
    running, developing = locked("requirements.txt"), locked("requirements-dev.txt")
    assert DEVELOPING <= developing.keys()
    assert not running.keys() & developing.keys()
    assert not running.keys() & DEVELOPING


def test_the_site_needs_what_fits_beside_the_other_lists() -> None:
    running, developing, site = (locked(f"requirements{end}.txt") for end in ("", "-dev", "-docs"))
    assert "sphinx" in site and not {"sphinx", "furo"} & (running.keys() | developing.keys())
    assert not running.keys() & site.keys()
    assert {name: developing[name] for name in site.keys() & developing.keys()}.items() <= site.items()


def test_locks_hold_hashes_and_no_addresses() -> None:
    for name in ("requirements.txt", "requirements-dev.txt", "requirements-docs.txt"):
        text = (REPOSITORY / name).read_text()
        assert "://" not in text
        assert len(re.findall(r"--hash=sha256:", text)) >= len(locked(name)) > 0


def test_files_of_a_newcomer_are_none_of_the_linters_business(tmp_path: Path) -> None:
    """What the documents tell to save in the top directory, in whatever style, keeps no test from running."""
    copy = tmp_path / "copy"
    ignored = shutil.ignore_patterns(".git", ".venv", "out", "__pycache__", ".mypy_cache", ".ruff_cache", "bags")
    shutil.copytree(REPOSITORY, copy, ignore=ignored, symlinks=True)
    for place in (copy, copy / "config", copy / "my_skill", copy / "docs"):
        place.mkdir(exist_ok=True)
        (place / "reproduce.py").write_text("import os,sys\nx = 1;y=2\ndef test_mine(): assert undefined\n")
        (place / "test_mine.py").write_text("def test_mine( ):  assert   False\n")
    run = [sys.executable, "-m"]
    for command in (["ruff", "check"], ["ruff", "format", "--check"]):
        result = subprocess.run([*run, *command], cwd=copy, capture_output=True, text=True)
        assert result.returncode == 0, result.stdout + result.stderr
    collected = subprocess.run(
        [*run, "pytest", "--collect-only", "-q", "test/test_setup.py"], cwd=copy, capture_output=True, text=True
    )
    assert collected.returncode == 0, collected.stdout + collected.stderr
    settings = (copy / "pyproject.toml").read_text()
    assert re.search(r"^testpaths = ", settings, re.MULTILINE) and re.search(r"^files = ", settings, re.MULTILINE)


def test_a_package_that_is_copied_elsewhere_is_built_with_its_configuration(tmp_path: Path) -> None:
    copy = tmp_path / "alone"
    shutil.copytree(
        REPOSITORY / "src/tpgmm_ros", copy, symlinks=True, ignore=shutil.ignore_patterns("*.egg-info", "build")
    )
    build = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir"]
    subprocess.run([*build, str(tmp_path), str(copy)], check=True, env=bare(), capture_output=True)
    (built,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        names = {Path(name).name for name in archive.namelist() if "/share/tpgmm_ros/config/" in name}
    expected = {path.name for path in (REPOSITORY / "config").rglob("*") if path.is_file()}
    assert names == expected and {"pick_place.yaml", "this_machine.xml"} <= names


@pytest.mark.parametrize("program", ["lib/tpgmm_ros/demo", "lib/tpgmm_demos/demo", "bin/another"])
def test_ctrl_c_before_the_imports_ends_our_executables_quietly_and_is_as_ever_for_all_others(
    environment: Path, tmp_path: Path, program: str
) -> None:
    """What Python does at its start takes for ever here, as soon as the environment's own lines have been read."""
    (packages,) = environment.glob("lib/python*/site-packages")
    hook = "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1]); import link_packages as tool"
    subprocess.run([sys.executable, "-c", f"{hook}; tool.hook(Path(sys.argv[2]))", TOOLS, packages], check=True)
    waiting = "import sys, time; print('begun', flush=True); time.sleep(60.0)\n"
    slow = packages / "a.pth"
    slow.write_text(waiting)
    script = environment / program
    script.parent.mkdir(parents=True, exist_ok=True)
    script.write_text(f"#!{environment}/bin/python\n")
    script.chmod(0o755)
    link = tmp_path / "link"
    link.symlink_to(script)
    try:
        for path in (script, link):
            with subprocess.Popen([path], env=bare(), stdout=-1, stderr=-1, text=True) as process:
                assert process.stdout is not None and process.stdout.readline() == "begun\n"
                process.send_signal(signal.SIGINT)
                _, errors = process.communicate(timeout=30)
            if program.startswith("lib"):
                assert (process.returncode, errors) == (-signal.SIGINT, "")
            else:
                assert "KeyboardInterrupt" in errors
    finally:
        slow.unlink()
