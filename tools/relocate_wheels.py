# SPDX-License-Identifier: Apache-2.0
"""Point the CMake files of the ROS wheels to this virtual environment.

The wheels carry two paths of the machine that built them. `find_package` of any interface package fails until
they are the include directory and the site-packages of the interpreter that runs here.
Running it again is harmless.
"""

import sys
import sysconfig
from pathlib import Path

BUILD_PREFIX = "/opt/python/cp312-cp312"


def relocate(prefix: Path) -> list[Path]:
    """Rewrite the baked-in paths in `prefix`/share/**/*.cmake; return the files that were changed."""
    replacements = {
        f"{BUILD_PREFIX}/include/python3.12": sysconfig.get_path("include"),
        f"{BUILD_PREFIX}/lib/python3.12/site-packages": sysconfig.get_path("purelib"),
    }
    changed = []
    for path in sorted((prefix / "share").rglob("*.cmake")):
        text = relocated = path.read_text()
        for baked_in, actual in replacements.items():
            relocated = relocated.replace(baked_in, actual)
        if relocated != text:
            path.write_text(relocated)
            changed.append(path)
    return changed


def main() -> None:
    """Point the CMake files of this environment to where it is."""
    if sys.prefix == sys.base_prefix:
        sys.exit("run this with the virtual environment's Python: .venv/bin/python tools/relocate_wheels.py")
    print(f"pointed {len(relocate(Path(sys.prefix)))} CMake files of the ROS wheels to {sys.prefix}")


if __name__ == "__main__":
    main()
