# SPDX-License-Identifier: Apache-2.0
"""The 1 kHz loop with a page of the workbench open, against the same loop without it, in turns.

The page has no browser (`page_client`): what draws it is another program, perhaps on another machine.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.graph import Scene, running
from benchmarks.loop import cpu_seconds, measure, ticks, torque_age
from benchmarks.page_client import open_page
from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.runtime.processes import end_with_parent
from tpgmm_ros.runtime.resources import config_file

PORT = 18680
#: s until the page is served; how much a figure may be worse with the page.
START, WORSE = 300.0, 1.1
NODES = ("reproduction", "impedance_controller")


@contextlib.contextmanager
def page(scene: Scene, folder: Path) -> Iterator[None]:
    """The workbench beside the nodes, with one page that is open; both end with the block."""
    given = {"project": folder, "task_file": config_file("pick_place.yaml"), "robot_file": config_file("baxter.yaml")}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "tpgmm_workbench.workbench", "--ros-args", *words, "-p", f"port:={PORT}"]
    with subprocess.Popen(command, preexec_fn=end_with_parent) as process:
        is_open, is_over = threading.Event(), threading.Event()
        user = threading.Thread(target=lambda: asyncio.run(_look(is_open, is_over)))
        user.start()
        try:
            scene.graph.wait_for(lambda: is_open.is_set() or not user.is_alive(), START + 60.0, "the page to be open")
            if not is_open.is_set():
                raise RuntimeError("the page could not be opened: see above for the reason")
            yield
        finally:
            is_over.set()
            user.join()
            process.terminate()


async def _look(is_open: threading.Event, is_over: threading.Event) -> None:
    """Open the page as soon as it is served, and look at it until it is over."""
    deadline = time.monotonic() + START
    while not is_open.is_set() and not is_over.is_set():
        try:
            async with open_page(f"http://127.0.0.1:{PORT}"):
                is_open.set()
                while not is_over.is_set():
                    await asyncio.sleep(0.1)
        except ConnectionRefusedError:
            if time.monotonic() > deadline:
                raise
            await asyncio.sleep(0.2)


def figures(scene: Scene, number: int, case: str) -> Row:
    """One movement: ticks that were done, times of steps and age of torques (ms), and cores that the loop took."""
    scene.run_for(2.0)
    used, began = cpu_seconds(scene), time.monotonic()
    counters, success = measure(scene)
    row: dict[str, str | float | bool | None] = {
        "round": number,
        "page": case,
        "cores": (cpu_seconds(scene) - used) / (time.monotonic() - began),
    }
    for node in NODES:
        found = ticks(counters, case, node, 0.0)
        short = node.partition("_")[0]
        row |= {f"{short}_share": found["share"], f"{short}_p50_ms": found["step_p50_ms"]}
    age = torque_age(counters, case, np.inf)
    return (
        row | {key: age[key] for key in ("age_p50_ms", "age_p99_ms")} | {"load": os.getloadavg()[0], "moved": success}
    )


def compared(rows: list[Row]) -> list[Row]:
    """Of each figure, the median of the rounds' ratios with the page to without; the share of ticks upside down."""
    found: list[Row] = []
    for key in rows[0].keys() - {"round", "page", "load", "moved"}:
        without, with_page = (
            np.array([row[key] for row in rows if row["page"] == case], float) for case in ("no", "open")
        )
        ratios = without / with_page if key.endswith("share") else with_page / without
        worse = float(np.median(ratios))
        found.append({
            "figure": key, "without": float(np.median(without)), "with": float(np.median(with_page)),
            "worse_by": worse, "least": float(ratios.min()), "most": float(ratios.max()), "passed": worse <= WORSE,
        })  # fmt: skip
    return sorted(found, key=lambda row: str(row["figure"]))


def main() -> int:
    """Measure; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="movements with and without it (default: %(default)s)")
    rows: list[Row] = []
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder, running(together=True) as scene:
        scene.reproduce(3.0)  # what is compiled or read at first counts nowhere
        for number in range(1, rounds + 1):
            rows.append(figures(scene, number, "no"))
            with page(scene, Path(folder) / "project"):
                rows.append(figures(scene, number, "open"))
    return write_report("loop_page_rounds", rows) | write_report("loop_page", compared(rows))


if __name__ == "__main__":
    sys.exit(main())
