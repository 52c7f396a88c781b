# SPDX-License-Identifier: Apache-2.0
"""Make the built workspace part of this virtual environment, as sourcing a setup.bash does for a shell.

Every Python process of the environment, whatever has started it, then imports the packages of the given
directories and finds what is installed (`get_package_share_directory` looks in AMENT_PREFIX_PATH).
"""

import sys
import sysconfig
from pathlib import Path


def main() -> None:
    if sys.prefix == sys.base_prefix or not sys.argv[1:]:
        sys.exit("usage: .venv/bin/python tools/activate_workspace.py DIRECTORY...")
    lines = ['import os, sys; os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)']
    lines += [str(Path(directory).resolve(strict=True)) for directory in sys.argv[1:]]
    Path(sysconfig.get_path("purelib"), "tpgmm_workspace.pth").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
