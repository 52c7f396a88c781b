# SPDX-License-Identifier: Apache-2.0
"""Pose to torque: an object moves, PoseStamped in → first changed torque out, both over DDS.

The nodes between them are apart or in one process, on an idle machine or beside two busy programs (`graph.CASES`).

The arm has reached the end of its movement and rests there, so that its torques hardly change from tick to tick; then
the target moves by some millimetres. The first torque that leaves the band of the ticks before is the answer. That the
band is not left without a reason is measured too: as many times nothing moves, and nothing must be taken for an answer.
Blending, which lets a moved frame take hold gradually, is set to its least: it does not delay the first change, it only
makes it too small to be told from the noise.
"""

from __future__ import annotations

import sys
import time
from collections import deque

import numpy as np
from sensor_msgs.msg import JointState

from benchmarks.graph import CASES, Scene, running
from benchmarks.report import without_options, write_report
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.runtime.scheduling import end_realtime, request_realtime

MOVES = 100
#: How far the target moves, m
STEP = 0.006
#: An answer changes a torque by this much from tick to tick, N m, and by this factor more than any tick just before
CHANGE, FACTOR = 0.03, 4.0
#: Without an answer for this long there is none, s
PATIENCE = 0.1
#: Without a move, torques leave the band this often at most; where they do so more often, answers may be chance
FALSE_ALARMS = 0.05


class Watch:
    """Watches the torques of the arm for the first that leaves the band of the ticks before."""

    def __init__(self, scene: Scene) -> None:
        robot = RobotModel.from_file(config_file("baxter.yaml"))
        self._reader = JointReader(robot.joint_groups[robot.endpoints["left"].joints])
        self._changes: deque[float] = deque(maxlen=30)
        self._last: np.ndarray | None = None
        self._threshold = np.inf
        self.answered_at: float | None = None
        scene.node.create_subscription(JointState, "joint_torques", self._take, STREAM)

    def arm(self) -> None:
        """From now on, tell when a torque changes by more than before."""
        self._threshold = max(CHANGE, FACTOR * max(self._changes))
        self.answered_at = None

    def _take(self, message: JointState) -> None:
        now = time.perf_counter()
        (torque,) = self._reader.read(message, "effort")
        if self._last is not None:
            change = float(np.abs(torque - self._last).max())
            if change > self._threshold and self.answered_at is None:
                self.answered_at = now
            self._changes.append(change)
        self._last = torque


def answer_time(scene: Scene, watch: Watch, move: bool) -> float | None:
    """Seconds from a pose to the torque that answers it, None without an answer."""
    watch.arm()
    start = time.perf_counter()
    if move:
        scene.show_one("target")
    scene.graph.wait_for(
        lambda: watch.answered_at is not None or time.perf_counter() - start > PATIENCE, 60.0, "an answer"
    )
    return None if watch.answered_at is None else watch.answered_at - start


def measure(scene: Scene, case: str, bounds: tuple[float, float]) -> dict[str, str | float | bool]:
    """Percentiles, ms, over many moves, held against bounds of p50 and p99.

    Pauses between them have different lengths, so that no tick's phase is preferred.
    """
    random = np.random.default_rng(0)
    watch = Watch(scene)
    print(f"movement: {scene.reproduce(5.0).reason}")
    home = scene.places["target"]
    answers: list[float | None] = []
    false_alarms = 0
    for i in range(MOVES):
        scene.run_for(random.uniform(0.25, 0.35))
        false_alarms += answer_time(scene, watch, move=False) is not None
        scene.places["target"] = home + STEP * (i % 2 == 0) * np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        answers.append(answer_time(scene, watch, move=True))
    times_ms = 1e3 * np.array([answer for answer in answers if answer is not None])
    p50, p99 = (float(value) for value in np.percentile(times_ms, (50, 99)))
    return {
        "case": case,
        "moves": MOVES,
        "answered": len(times_ms),
        "false_alarms": false_alarms,
        "p50_ms": p50,
        "p99_ms": p99,
        "max_ms": float(times_ms.max()),
        "passed": p50 <= bounds[0]
        and p99 <= bounds[1]
        and len(times_ms) >= 0.95 * MOVES
        and false_alarms <= FALSE_ALARMS * MOVES,
    }


#: Of p50 and p99, ms, to reach.
BOUNDS = {
    "apart": (2.0, 6.0),
    "one process": (1.5, 3.0),
    "apart, load": (np.inf, np.inf),
    "one process, load": (np.inf, 5.0),
}

if __name__ == "__main__":
    without_options(__doc__)
    rows = []
    for name, together, load in CASES:
        with running(together, load, blend_time=0.001) as running_scene:
            # What is measured must not be how long this program waits for its turn.
            request_realtime(REALTIME_PRIORITY)
            rows.append(measure(running_scene, name, BOUNDS[name]))
            end_realtime()
    sys.exit(write_report("latency", rows))
