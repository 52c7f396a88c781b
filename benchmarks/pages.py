# SPDX-License-Identifier: Apache-2.0
"""Many pages of the workbench at once: what each is sent, what it costs the node, and whether each of them can stop.

The pages have no browser (`page_client`): a browser without a graphics card costs more than all that is measured here.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.page_client import PageClient, open_page
from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.runtime.processes import end_with_parent

PORT = 18480
#: s until the program serves its page, until pages show the same; how long each number of pages is measured; how long
#: the hand is led one way.
START, SAME, SECONDS, ONE_WAY = 300.0, 60.0, 10.0, 2.5
#: All pages say so within this time of a STOP, s: long before the hand would have come to the end of its way by itself.
STOPPED = 0.4 * ONE_WAY
#: What a page says while the hand is not led; once the object is seen; and where the robot is not heard.
NOBODY, SEEN, UNHEARD = "Nobody leads the hand", "object: seen", "no joint states arrive"


@contextlib.contextmanager
def serving(folder: Path, port: int = PORT, options: Sequence[str] = ()) -> Iterator[tuple[int, str]]:
    """The workbench with a simulated robot and a new project; its process id, and the address of its page.

    Raises
    ------
    RuntimeError
        where it does not serve its page, or an error of its own was written meanwhile
    """
    command = [sys.executable, "-m", "tpgmm_workbench.simulated", "--project", str(folder / "project")]
    command += ["--log", str(folder / "log"), "--seed", "3", "--port", str(port), *options]
    said = folder / "said"
    with said.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, preexec_fn=end_with_parent)
    try:
        deadline = time.monotonic() + START
        while "Ctrl-C" not in said.read_text():
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"the workbench does not serve its page; it says: {said.read_text()}")
            time.sleep(0.1)
        yield process.pid, next(word for word in said.read_text().split() if word.startswith("http://127.0.0.1:"))
    finally:
        process.terminate()
        process.wait()
    if "Traceback" in said.read_text():
        raise RuntimeError(f"an error of the workbench: {said.read_text()}")


def children(pid: int) -> dict[int, str]:
    """Process ids and command lines of the processes that a process has started (Linux)."""
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return {int(child): Path(f"/proc/{child}/cmdline").read_text().replace("\0", " ") for child in found}


async def open_pages(stack: contextlib.AsyncExitStack, address: str, count: int) -> list[PageClient]:
    """So many pages, open as long as the stack is."""
    return [await stack.enter_async_context(open_page(address)) for _ in range(count)]


async def show_the_same(pages: Sequence[PageClient]) -> None:
    """Wait until all pages show the same, and one of them drives. Raises TimeoutError where they do not."""
    first = pages[0]
    try:
        await first.until(lambda: all(page.shared == first.shared for page in pages), "the same on all pages", SAME)
    except TimeoutError:
        shown = [page.shared for page in pages]
        other = {key: [one.get(key) for one in shown] for key in set().union(*shown)}
        differ = {key: values for key, values in other.items() if any(value != values[0] for value in values)}
        raise TimeoutError(f"not within {SAME} s: the same on all pages; these differ: {differ}") from None
    if len(pages) > 1:
        await pages[0].until(
            lambda: sorted("this one drives" in page.text for page in pages) == [False] * (len(pages) - 1) + [True],
            "one page that drives",
        )


async def lead(pages: Sequence[PageClient]) -> None:
    """Let the first page, which drives, lead the hand: again where it refused, once robot and object are there.

    Raises
    ------
    TimeoutError
        where the page neither says that they are there, nor that the hand is led, nor why not
    """
    first = pages[0]

    def is_led() -> bool:
        return not any(NOBODY in page.text for page in pages)

    while not is_led():
        await first.until(lambda: SEEN in first.text and UNHEARD not in first.text, "robot and object to be there")
        await first.press("object", "to object")
        await first.until(lambda: is_led() or UNHEARD in first.text, "all pages to say that the hand is led")


async def stop_from_each(pages: Sequence[PageClient]) -> list[float]:
    """Let the first page, which drives, lead the hand, and stop it from each; s until all pages are told."""
    took = []
    for page in pages:
        await lead(pages)
        began = time.monotonic()
        await page.press("STOP")
        await page.until(lambda: all(NOBODY in one.text for one in pages), "the stop on all pages")
        took.append(time.monotonic() - began)
    return took


async def measure(pid: int, pages: Sequence[PageClient], moves: bool) -> Row:
    """What pages are sent, and what it costs, while the hand is at rest, or is led here and there."""
    sent, used, began = [_counts(page) for page in pages], _cores(pid), time.monotonic()
    while time.monotonic() < began + SECONDS:
        if moves:
            await pages[0].press("hand", "home")
            await asyncio.sleep(ONE_WAY)
            await pages[0].press("object", "to object")
        await asyncio.sleep(ONE_WAY)
    lasted = time.monotonic() - began
    packets, kilobytes, messages, repeated = (
        sum(now - before for now, before in zip(counts, befores, strict=True)) / lasted / len(pages)
        for counts, befores in zip(zip(*map(_counts, pages), strict=True), zip(*sent, strict=True), strict=True)
    )
    node, others = ((now - before) / lasted for now, before in zip(_cores(pid), used, strict=True))
    return {
        "pages": len(pages),
        "hand": "led" if moves else "at rest",
        "packets_per_s": packets,
        "kB_per_s": kilobytes,
        "messages_per_s": messages,
        "repeated_per_s": repeated,
        "node_cores": node,
        "other_threads_cores": others,
        "load": os.getloadavg()[0],
    }


def _counts(page: PageClient) -> tuple[float, ...]:
    return page.frames, 1e-3 * page.bytes, page.messages, page.repeated


def _cores(pid: int) -> tuple[float, float]:
    """Processor time, s, of the thread that serves topics, and of all others: the server of pages, DDS."""
    times = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        fields = (task / "stat").read_text().rpartition(")")[2].split()
        times[int(task.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return times[pid], sum(times.values()) - times[pid]


async def compare(pid: int, address: str, numbers: Sequence[int]) -> tuple[list[Row], list[Row]]:
    """Measure each number of pages; what they cost, and how long each STOP took."""
    costs: list[Row] = []
    stops: list[Row] = []
    for count in numbers:
        async with contextlib.AsyncExitStack() as stack:
            pages = await open_pages(stack, address, count)
            await show_the_same(pages)
            costs += [await measure(pid, pages, moves) for moves in (False, True)]
            took = await stop_from_each(pages)
            stops.append({"pages": count, "stops": len(took), "longest_s": max(took), "passed": max(took) <= STOPPED})
    return costs, stops


def main() -> int:
    """Measure; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--pages", type=int, nargs="+", default=[1, 3, 10], help="how many at once (default: %(default)s)"
    )
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as (pid, address):
        costs, stops = asyncio.run(compare(pid, address, parser.parse_args().pages))
    return write_report("pages", costs) | write_report("pages_stop", stops)


if __name__ == "__main__":
    sys.exit(main())
