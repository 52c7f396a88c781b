# SPDX-License-Identifier: Apache-2.0
"""Make Python packages of the workspace part of this virtual environment, as `colcon build` and a setup.bash do.

    .venv/bin/python tools/link_packages.py src/tpgmm_core src/tpgmm_ros src/tpgmm_demos src/tpgmm_workbench

Modules and data files are linked, not copied: a change needs no build. Executables lie in lib/<package>, where
`ros2 run` looks. Every Python process of the environment then finds all of it, whatever has started it. colcon itself
would bring pytest with it, which running does not need.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import sysconfig
from pathlib import Path

import setuptools  # noqa: F401  before distutils, which it brings
from distutils.core import run_setup


def link(package: Path) -> None:
    """Modules and executables by `setup.py develop`, data files by links to them."""
    develop = [sys.executable, "-W", "ignore", "setup.py", "--quiet", "develop", "--no-deps"]
    run = subprocess.run(develop, cwd=package, capture_output=True, text=True)
    if run.returncode:
        sys.exit(f"{run.stdout}{run.stderr}error: {package} could not be linked")
    with contextlib.chdir(package):
        data_files = run_setup("setup.py", stop_after="init").data_files
        for directory, files in data_files:
            target = Path(sys.prefix, directory)
            target.mkdir(parents=True, exist_ok=True)
            for file in map(Path, files):
                (target / file.name).unlink(missing_ok=True)
                (target / file.name).symlink_to(file.resolve(strict=True))


def hook(directory: Path) -> None:
    """Lines that every Python process of the environment runs at its start, before any other: they take no time."""
    # What a process finds of the workspace: `get_package_share_directory` looks in AMENT_PREFIX_PATH
    found = 'import os, sys; os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)'
    # Python answers Ctrl-C with a traceback, whenever it comes. Until `tpgmm_ros.runtime.entry` knows better, it just
    # ends our executables. All other programs, such as pytest and the own scripts of users, have it as it was
    quiet = (
        'import os, sys; folder = os.path.dirname(os.path.realpath(getattr(sys, "argv", [""])[0])); '
        'lib = os.path.realpath(os.path.join(sys.prefix, "lib")); '
        'ours = folder in [os.path.join(lib, name) for name in ("tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")]; '
        'ours and (signal := __import__("signal")).signal(signal.SIGINT, signal.SIG_DFL)'
    )
    # In the order of their names; that of the ROS wheels starts Python a second time
    (directory / "_tpgmm_workspace.pth").write_text(f"{found}\n{quiet}\n")


def main() -> None:
    """Link the packages that the arguments name into the environment."""
    if sys.prefix == sys.base_prefix or not sys.argv[1:]:
        sys.exit("usage: .venv/bin/python tools/link_packages.py DIRECTORY...")
    for directory in sys.argv[1:]:
        link(Path(directory).resolve(strict=True))
    hook(Path(sysconfig.get_path("purelib")))


if __name__ == "__main__":
    main()
