# SPDX-License-Identifier: Apache-2.0
"""`evaluate` or `train --auto` in one process, in two, and on a Dask cluster of two workers: the same, bit by bit.

Dask is no requirement of the project: pip install dask distributed.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path

import joblib

from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.programs import evaluate, train


def results(task: Path, bags: Path, method: str, jobs: int) -> str:
    """What `evaluate` finds, as JSON, which holds all digits."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        status = evaluate.main(
            ["--json", "--task", str(task), "--methods", method, "--jobs", str(jobs), "--", str(bags)]
        )
    if status:
        raise RuntimeError(f"evaluate ended with status {status}: {said.getvalue()[:500]}")
    return json.dumps(json.loads(said.getvalue())["results"])


def choice(task: Path, bags: Path, trials: int, workers: int) -> str:
    """What `train --auto` chooses and with which errors, as JSON."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        given = ["--task", task, "--auto", "--trials", trials, "--workers", workers, "--output", f"{folder}/m.tpgmm"]
        status = train.main([*map(str, given), "--report", folder, "--", str(bags)])
        if status:
            raise RuntimeError(f"train ended with status {status}")
        found = json.loads((Path(folder) / "report.json").read_text())["auto"]
    return json.dumps([found["best"], found["errors"]])


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="task file")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="folder of bags")
    parser.add_argument("--method", default="adapt_regress", help="retrieval method (default: adapt_regress)")
    parser.add_argument("--auto", type=int, metavar="TRIALS", help="train --auto with so many trials, not evaluate")
    options = parser.parse_args()
    try:
        import distributed
    except ModuleNotFoundError:
        parser.error("Dask is not installed, which only this benchmark needs: pip install dask distributed")

    found: dict[str, tuple[float, str]] = {}

    def measure(name: str, jobs: int) -> None:
        begin = time.perf_counter()
        if options.auto is None:
            text = results(options.task, options.bags, options.method, jobs)
        else:
            text = choice(options.task, options.bags, options.auto, jobs)
        found[name] = time.perf_counter() - begin, text

    measure("one process", 1)
    measure("two processes", 2)
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
        joblib.parallel_config("dask"),
    ):
        client.wait_for_workers(2)
        with distributed.get_task_stream(client) as tasks:
            measure("Dask, two workers", 2)
        workers = len({task["worker"] for task in tasks.data})
    rows: list[Row] = []
    for name, (seconds, text) in found.items():
        is_cluster = name.startswith("Dask")
        same = text == found["one process"][1] and (not is_cluster or workers == 2)
        rows.append(
            {
                "way": name,
                "s": seconds,
                "workers that took part": workers if is_cluster else None,
                "sha256 of the results": hashlib.sha256(text.encode()).hexdigest()[:16],
                "passed": same,
            }
        )
    return write_report("cluster" if options.auto is None else "cluster_auto", rows)


if __name__ == "__main__":
    sys.exit(main())
