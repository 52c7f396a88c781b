# SPDX-License-Identifier: Apache-2.0
"""The 1 kHz loop in real time beside the workbench, with no page open, one, and ten: ticks, step times, torques' age.

    PYTHONPATH=. .venv/bin/python benchmarks/pages.py

All pages are open in one browser on this machine, which draws without a graphics card; that all of them see the same,
and that one of them drives, is checked. What the loop's figures are beside no workbench counts as one; the other rows
are shares of them. Needs Playwright (`make dev`) and Chromium.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from benchmarks.graph import running
from benchmarks.loop import Counters, measure
from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.runtime.resources import config_file

FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
PORT, PATIENCE = 18380, 120.0
CONTROLLER, SIMULATOR = "impedance_controller", "baxter_simulator"
#: The loop keeps its figures within this share beside one page: what the workbench promises.
SHARE = 0.1


@contextlib.contextmanager
def workbench(frame_rate: float) -> Iterator[str]:
    """The workbench beside the nodes that run; gives the address of its page."""
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name, "project"), Path(name, "log")
        given = {
            "project": folder, "task_file": config_file("pick_place.yaml"), "robot_file": config_file("baxter.yaml"),
            "port": PORT, "frame_rate": frame_rate,
        }  # fmt: skip
        command = [sys.executable, "-m", "tpgmm_workbench.workbench", "--ros-args"]
        command += [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        with log.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as process:
            try:
                yield _address(log, process)
            finally:
                process.terminate()


def _address(log: Path, process: subprocess.Popen[bytes]) -> str:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline and process.poll() is None:
        if found := re.search(r"the page is at (\S+)", log.read_text(errors="replace")):
            return found[1]
        time.sleep(0.1)
    raise RuntimeError(f"no page: {log.read_text(errors='replace')[-2000:]}")


@contextlib.contextmanager
def pages(address: str, count: int) -> Iterator[list[Any]]:
    """So many pages in one browser, all of them heard by the workbench."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium") or shutil.which("chromium-browser"), args=FLAGS
        )
        opened = [browser.new_page(viewport={"width": 640, "height": 480}) for _ in range(count)]
        for page in opened:
            page.set_default_timeout(1e3 * PATIENCE)
            page.goto(address)
        for page in opened:
            page.get_by_role("button", name="STOP").first.wait_for()
            page.wait_for_function("document.getElementById('tpgmm-notice')?.textContent === ''")
        yield opened
        browser.close()


def agree(opened: list[Any]) -> bool:
    """Whether all pages list the same nodes, and one of them says that it drives."""
    if len(opened) < 2:
        return True
    said = [str(page.evaluate("document.body.innerText")) for page in opened]
    count = sum(f"{len(opened)} pages show this; this one drives" in text for text in said)
    others = sum("another one drives" in text for text in said)
    states = {tuple(sorted(set(re.findall(r"\w+: (?:seen|held|missing|fixed)", text)))) for text in said}
    print(f"{len(opened)} pages: {count} drives, {others} say that another one does; they see {states}")
    return count == 1 and others == len(opened) - 1 and len(states) == 1


def figures(counters: Counters) -> dict[str, float]:
    """Share of the ticks that were kept, time per step, and age of what the torques answer."""
    first, last = counters.rows[CONTROLLER][0], counters.rows[CONTROLLER][-1]
    asked, done = (int(last[key]) - int(first[key]) for key in ("ticks_asked", "ticks_done"))
    age = counters.rows[SIMULATOR][-1]
    return {
        "ticks_kept": done / asked,
        "step_p50_ms": float(last["step_p50_ms"]),
        "step_p99_ms": float(last["step_p99_ms"]),
        "age_p50_ms": float(age["age_p50_ms"]),
        "age_p99_ms": float(age["age_p99_ms"]),
    }


def _share(row: Row, alone: dict[str, float]) -> Row:
    shares = {key: float(str(row[key])) / value for key, value in alone.items()}
    few = row["case"] in ("0 pages", "1 pages")  # ten browsers on the robot's own machine are promised to nobody
    return {"case": row["case"], **shares, "passed": shares["ticks_kept"] >= 1.0 - SHARE if few else None}


def main() -> int:
    """Measure, one case after the other, and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pages", type=int, nargs="+", default=[0, 1, 10], help="numbers of pages that are compared")
    parser.add_argument("--frame-rate", type=float, default=30.0, help="pages are renewed this often, Hz")
    arguments = parser.parse_args()
    rows: list[Row] = []
    agreed: list[Row] = []
    with running(together=True) as scene:
        scene.run_for(2.0)
        measure(scene)  # the first movement warms up
        alone = figures(measure(scene)[0])
        rows.append({"case": "no workbench", **alone})
        for count in arguments.pages:
            with workbench(arguments.frame_rate) as address, pages(address, count) as opened:
                scene.run_for(3.0)
                agreed.append({"pages": count, "passed": agree(opened)})
                found = figures(measure(scene)[0])
            rows.append({"case": f"{count} pages", **found})
    shares = [_share(row, alone) for row in rows[1:]]
    status = write_report("pages", rows) | write_report("pages_agree", agreed)
    return status | write_report("pages_shares_of_no_workbench", shares)


if __name__ == "__main__":
    sys.exit(main())
