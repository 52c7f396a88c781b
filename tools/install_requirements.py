# SPDX-License-Identifier: Apache-2.0
"""Install what a lock holds into this environment, exactly that, and check that it fits together.

    .venv/bin/python tools/install_requirements.py requirements.txt [PIP'S OWN ARGUMENTS]

Nothing is resolved (`--no-deps`): the lock is whole, and a resolver that looks at newer releases may refuse what was
locked before they appeared. `pip check` then finds what a lock lacks. Every wheel has to have the hash that is locked.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from progress import run

#: A line that pip writes once for each wheel that it takes.
TAKEN = re.compile(r"^\s*(Collecting|Processing|Requirement already satisfied)\b")


def main() -> int:
    """Install a lock; returns pip's exit status."""
    if sys.prefix == sys.base_prefix or not sys.argv[1:]:
        sys.exit("usage: .venv/bin/python tools/install_requirements.py LOCK [PIP'S OWN ARGUMENTS]")
    lock, *further = sys.argv[1:]
    total = len(re.findall(r"^[^\s#-].*==", Path(lock).read_text(), re.MULTILINE))
    before = _megabytes()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    install = ["install", "--no-deps", "--require-hashes", "--progress-bar", "off"]
    log_path = Path(sys.prefix, "log", f"{Path(lock).stem}.log")
    log_path.parent.mkdir(exist_ok=True)
    with log_path.open("w") as log:
        status = run([*pip, *install, "--requirement", lock, *further], log, TAKEN, total)
    if status:
        return status
    print(f"    {total} wheels of {lock}: {_megabytes() - before} MB more in {sys.prefix}")
    check = subprocess.run([*pip, "check"], capture_output=True, text=True)
    if check.returncode:
        sys.exit(f"{check.stdout}error: {lock} is incomplete: see above; `make lock` makes a new one")
    return 0


def _megabytes() -> int:
    """What the environment takes on the disk."""
    prefix = Path(sys.prefix)
    files = (path for path in prefix.rglob("*") if path.is_file() and not path.is_symlink())
    return round(sum(path.stat().st_size for path in files) / 1e6)


if __name__ == "__main__":
    sys.exit(main())
