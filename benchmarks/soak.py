# SPDX-License-Identifier: Apache-2.0
"""Long operation with random faults, in lockstep: tasks that were done and lost, and the memory of each process.

Tasks of random situations follow one another. Meanwhile frames are hidden, leap and come as no poses, the hand is
pushed, models are exchanged during the movement, and, in the first third of the time, nodes are killed and started
again. A task is lost when it does not end well in ATTEMPTS attempts. Writes out/soak/report.json.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from benchmarks.soak_world import SoakWorld
from tpgmm_core.common.report import format_table
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros.programs import train
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.runtime.graph import Graph, open_graph, own_domain
from tpgmm_ros.runtime.processes import GraphError, NodeProcesses
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

BAGS = Path("bags/pick_place")
TASK_FILE, ROBOT_FILE = config_file("pick_place.yaml"), config_file("baxter.yaml")
START_TIMEOUT = 120.0
ATTEMPTS = 4
#: Joint states per second of simulated time. Each costs three messages between processes, at any rate: a loop at
#: 500 Hz, as many robots have it, gets twice as far in the same time.
RATE = 500.0
NODES = ("frame_tracker", "reproduction", "impedance_controller", "baxter_simulator")
#: A goal that nobody accepted within this time went to a process that was killed, of which DDS does not know yet, s.
ACCEPT_TIMEOUT = 5.0
#: Kills come this often, s of simulated time; of tasks, every so many one has its model exchanged.
KILL_PERIOD = 25.0
SWAP_EVERY = 2
SAMPLE_PERIOD = 2.0
#: The first minute fills caches; then the memory of a process may grow by this much until its end.
SETTLING, MAX_GROWTH_MB = 60.0, 1.0


@dataclass(frozen=True, slots=True)
class Life:
    """Memory of one process from its start to its end, or to the end of the soak."""

    node: str
    lived_s: float
    settled_mb: float | None
    last_mb: float

    @property
    def growth_mb(self) -> float | None:
        """After the first minute; None for a process that did not live for two."""
        return None if self.settled_mb is None else self.last_mb - self.settled_mb


class Memory:
    """Resident memory of processes over time (wall clock), from /proc."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, int], list[tuple[float, float]]] = {}
        self._due = 0.0

    def sample(self, processes: NodeProcesses) -> None:
        """Read the memory of all nodes, at most every SAMPLE_PERIOD."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + SAMPLE_PERIOD
        for node in NODES:
            pid = processes.pid(node)
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
            self._samples.setdefault((node, pid), []).append((now, 1e-6 * pages * os.sysconf("SC_PAGE_SIZE")))

    def lives(self) -> list[Life]:
        """What was read, one for each process that a node had."""
        lives = []
        for (node, _), samples in self._samples.items():
            times, sizes = np.array(samples).T
            age = times - times[0]
            settled = sizes[(age >= SETTLING) & (age < 1.25 * SETTLING)]
            lives.append(
                Life(
                    node,
                    float(age[-1]),
                    float(np.median(settled)) if age[-1] >= 2.0 * SETTLING and len(settled) else None,
                    float(np.median(sizes[-8:])),
                )
            )
        return lives


class Soak:
    """One run: the graph, the world, and what happened."""

    def __init__(self, node: Node, graph: Graph, models: list[Path], seed: int, duration: float) -> None:
        self.node, self.graph, self.models, self.duration = node, graph, models, duration
        self.random = np.random.default_rng([seed, 1])
        self.world = SoakWorld(node, Task.load(TASK_FILE), np.random.default_rng([seed, 2]))
        self.memory = Memory()
        self.happened: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self._kill_at = KILL_PERIOD
        self._swap: Future | None = None
        self._client = ActionClient(node, Reproduce, "reproduce")
        self._loader = node.create_client(LoadModel, "load_model")

    def start(self, name: str) -> None:
        """Start a node; lifecycle nodes activate themselves."""
        settings: dict[str, Any] = {
            "frame_tracker": {"task_file": TASK_FILE, "lockstep": True, "use_sim_time": True},
            "reproduction": {
                "task_file": TASK_FILE,
                "model_file": self.models[0],
                "lockstep_rate": 100.0,
                "start_timeout": START_TIMEOUT,
                "use_sim_time": True,
                "autostart": True,
            },
            "impedance_controller": {
                "robot_file": ROBOT_FILE,
                "lockstep": True,
                "use_sim_time": True,
                "autostart": True,
            },
            "baxter_simulator": {"robot_file": ROBOT_FILE, "lockstep": True, "rate": RATE},
        }[name]
        self.graph.processes.start(name, **settings)

    def run(self) -> None:
        """Tasks until the simulated time is over."""
        for name in NODES:
            self.start(name)
        while self.world.elapsed < self.duration:
            self.world.rearrange()
            self.happened["tasks"] += 1
            if any(self._attempt() for _ in range(ATTEMPTS)):
                self.happened["done"] += 1
            else:
                self.happened["lost"] += 1
            minutes, done, lost = self.world.elapsed / 60.0, self.happened["done"], self.happened["lost"]
            print(f"\r{minutes:.1f} min simulated, {done} tasks done, {lost} lost ", end="", flush=True)

    def _attempt(self) -> bool:
        """Ask for the task once; whether it ended well. What happens meanwhile happens on the way."""
        self.happened["attempts"] += 1
        goal = Reproduce.Goal(duration=float(self.random.uniform(4.0, 8.0)))
        sent: Future | None = None
        sent_at = 0.0
        swap_at = self.world.elapsed + self.random.uniform(1.0, 3.0)
        if self.happened["tasks"] % SWAP_EVERY:
            swap_at = np.inf
        result: Future | None = None
        progress, deadline = self.world.elapsed, time.monotonic() + START_TIMEOUT
        while True:
            self.graph.executor.spin_once(timeout_sec=0.05)
            self.graph.processes.check()
            self.memory.sample(self.graph.processes)
            if result is None and sent is not None and sent.done():
                result = sent.result().get_result_async()
            elif result is None and time.monotonic() > sent_at + ACCEPT_TIMEOUT and self._client.server_is_ready():
                sent, sent_at = self._client.send_goal_async(goal), time.monotonic()
            if result is not None and result.done():
                break
            if self.world.elapsed > swap_at and self._loader.service_is_ready():
                swap_at = np.inf
                self._exchange_model()
            if self.world.elapsed > self._kill_at and self.world.elapsed < self.duration / 3.0:
                self._kill_at = self.world.elapsed + KILL_PERIOD
                if self._kill(NODES[int(self.random.integers(len(NODES)))]):
                    self.reasons["reproduction was killed"] += 1
                    return False
            if self.world.elapsed > progress:  # simulated time may be slow, but has to go on
                progress, deadline = self.world.elapsed, time.monotonic() + START_TIMEOUT
            if time.monotonic() > deadline:
                raise GraphError(f"time stalled for more than {START_TIMEOUT:g} s")
        answer = result.result()
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            self.reasons[answer.result.reason.split(":")[0]] += 1
        return bool(answer.status == GoalStatus.STATUS_SUCCEEDED)

    def _exchange_model(self) -> None:
        self.models.append(self.models.pop(0))
        self.happened["models exchanged"] += 1
        self._loader.call_async(LoadModel.Request(path=str(self.models[0])))

    def _kill(self, name: str) -> bool:
        """Kill a node and start it again; whether the movement has gone with it."""
        self.happened[f"{name} killed"] += 1
        self.graph.processes.kill(name)
        self.start(name)
        return name == "reproduction"


def _models(directory: Path) -> list[Path]:
    """Two models of the task, to exchange one for the other."""
    models = []
    for method in ("adapt_regress", "regress_product"):
        task = directory / f"{method}.yaml"
        task.write_text(TASK_FILE.read_text().replace("model: {", f"model: {{retrieval: {method}, "))
        models.append(directory / f"{method}.tpgmm")
        if train.main(["--task", str(task), "--output", str(models[-1]), str(BAGS)]) != 0:
            raise GraphError(f"no model from {BAGS}: see above for the reason")
    return models


def _report(soak: Soak, arguments: argparse.Namespace, took: float, error: str) -> dict[str, Any]:
    lives = soak.memory.lives()
    growths = [life.growth_mb for life in lives if life.growth_mb is not None]
    watched = {life.node for life in lives if life.growth_mb is not None}
    flat = watched == set(NODES) and max(growths) <= MAX_GROWTH_MB
    happened = {key.replace(" ", "_"): count for key, count in (soak.happened + soak.world.happened).items()}
    simulated = soak.world.elapsed
    return {
        "passed": not error and flat and soak.happened["lost"] == 0 and simulated >= 60.0 * arguments.minutes,
        "error": error,
        "seed": arguments.seed,
        "simulated_time_s": simulated,
        "real_time_factor": simulated / took,
        "tasks_done": soak.happened["done"],
        "tasks_lost": soak.happened["lost"],
        "largest_growth_mb": max(growths, default=None),
        "memory_is_flat": flat,
        "happened": happened,
        "failed_attempts": dict(soak.reasons),
        "lives": [{**asdict(life), "growth_mb": life.growth_mb} for life in lives],
    }


def main() -> int:
    """Run it; returns the exit status, 0 where nothing was lost and nothing grew."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0, help="of simulated time (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of tasks and faults (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("out/soak"), help="report, logs (default: %(default)s)")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "report.json").unlink(missing_ok=True)
    models = _models(arguments.output)
    error = ""
    with own_domain(), open_graph("soak", arguments.output / "log") as graph:
        begun = time.monotonic()
        soak = Soak(graph.node, graph, models, arguments.seed, 60.0 * arguments.minutes)
        try:
            soak.run()
        except (GraphError, KeyboardInterrupt) as failure:
            error = str(failure) or "interrupted"
        took = time.monotonic() - begun
    report = _report(soak, arguments, took, error)
    rows = [(key, str(value)) for key, value in report.items() if key != "lives"]
    lives = [(life["node"], life["lived_s"], life["last_mb"], life["growth_mb"] or "-") for life in report["lives"]]
    print("\n" + format_table(("what", "value"), rows))
    print(format_table(("process", "lived, s", "memory, MB", "growth after a minute, MB"), lives))
    print(f"report: {write_report(arguments.output, report)}")
    return 0 if report["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
