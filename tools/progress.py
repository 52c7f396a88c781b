# SPDX-License-Identifier: Apache-2.0
"""Run a command that is silent, or talks too much, and say every ten seconds that it still works.

    python tools/progress.py [--count PATTERN --of NUMBER] LOG COMMAND...

What the command writes goes to the file LOG. Each line of progress shows the time and, with --count, how many lines
matched so far; else the last line. A command that fails has all of its output shown, and its status is passed on.
Lines are never overwritten, so that a log of this reads well, too.
"""

from __future__ import annotations

import argparse
import queue
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO

#: Seconds between two lines of progress.
PERIOD = 10.0
#: Characters of the last line that are shown.
WIDTH = 90


def main() -> int:
    """Run the command that the arguments name; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=re.compile, help="count the lines that match this regular expression")
    parser.add_argument("--of", type=int, default=0, help="how many there will be")
    parser.add_argument("log", type=Path)
    parser.add_argument("command", nargs=argparse.REMAINDER)
    arguments = parser.parse_args()
    arguments.log.parent.mkdir(parents=True, exist_ok=True)
    with arguments.log.open("w") as log:
        try:
            return run(arguments.command, log, arguments.count, arguments.of)
        finally:
            log.flush()


def run(command: list[str], log: IO[str], count: re.Pattern[str] | None, total: int) -> int:
    """Run the command to its end; its exit status."""
    begun = told = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    assert process.stdout is not None
    lines: queue.Queue[str | None] = queue.Queue()
    threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
    output, last, seen = [], "", 0
    while True:
        try:
            line = lines.get(timeout=max(0.0, told + PERIOD - time.monotonic()))
        except queue.Empty:
            line = ""
        if line is None:
            break
        if line:
            log.write(line)
            output.append(line)
            last = line.strip() or last
            seen += bool(count and count.search(line))
        if time.monotonic() - told >= PERIOD:
            told = time.monotonic()
            state = f"{seen} of {total}" if count and seen < total else last[:WIDTH] or " ".join(command)[-WIDTH:]
            print(f"    {told - begun:4.0f} s  {state}", flush=True)
    status = process.wait()
    if status:
        sys.stderr.write("".join(output))
        print(f"error: failed with status {status}: {' '.join(command)}", file=sys.stderr)
    else:
        print(f"    done in {time.monotonic() - begun:.0f} s", flush=True)
    return status


def _read(stream: IO[str], lines: queue.Queue[str | None]) -> None:
    for line in stream:
        lines.put(line)
    lines.put(None)


if __name__ == "__main__":
    sys.exit(main())
