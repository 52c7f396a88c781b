# SPDX-License-Identifier: Apache-2.0
"""The executables of this package by their names, as setup.py lists them. Nothing here takes time to import."""

from __future__ import annotations

import sys
from collections.abc import Callable

from tpgmm_ros.runtime.entry import missing, node, program


def _elsewhere(package: str, run: Callable[[], int], name: str) -> Callable[[], int]:
    """An executable of another package, under its name here; without that package, it says what to install."""

    def start() -> int:
        if reason := missing(package, name):
            print(f"error: {reason}", file=sys.stderr)
            return 1
        return run()

    return start


frame_tracker = node("tpgmm_ros.nodes.frame_tracker")
reproduction = node("tpgmm_ros.nodes.reproduction")
impedance_controller = node("tpgmm_ros.nodes.impedance_controller")
joint_motion = node("tpgmm_ros.nodes.joint_motion")
joint_reference = node("tpgmm_ros.nodes.joint_reference")
baxter_simulator = node("tpgmm_ros.nodes.baxter_simulator")
endpoint_poses = node("tpgmm_ros.nodes.endpoint_poses")
recognition = node("tpgmm_ros.nodes.recognition")
compose = node("tpgmm_ros.programs.compose")
check_robot = program("tpgmm_ros.programs.check_robot")
convert = program("tpgmm_ros.programs.convert")
inspect = program("tpgmm_ros.programs.inspect")
record = node("tpgmm_ros.programs.record")
teach = program("tpgmm_ros.programs.teach")
train = program("tpgmm_ros.programs.train")
evaluate = program("tpgmm_ros.programs.evaluate")
show = program("tpgmm_ros.programs.show")
recognize = program("tpgmm_ros.programs.recognize")
demo = _elsewhere("tpgmm_demos", program("tpgmm_demos.demo"), "demo")
figure5 = _elsewhere("tpgmm_demos", program("tpgmm_demos.figure5"), "figure5")
workbench = _elsewhere("tpgmm_workbench", node("tpgmm_workbench.workbench"), "workbench")
