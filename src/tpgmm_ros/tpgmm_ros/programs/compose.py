# SPDX-License-Identifier: Apache-2.0
"""compose: run several nodes in one process, from pose to torque without the middleware in between.

Each node keeps its name, parameters, topics, services and diagnostics. What one of them publishes is passed to the
others directly, and also published if another process subscribes. List the nodes in the order of the data flow:

  ros2 run tpgmm_ros compose frame_tracker reproduction impedance_controller --ros-args \
    -p task_file:=TASK -p reproduction:model_file:=MODEL -p robot_file:=ROBOT -p autostart:=true

A parameter is set for all nodes that have it; NODE:NAME:=VALUE sets it for one of them. An error in one node ends only
that node; a signal, or the end of the process, ends all of them.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from rclpy.utilities import remove_ros_args

from tpgmm_core.common.text import listed
from tpgmm_ros.runtime.executor import run_together

#: Executable of a node -> its class, in a module of the executable's name.
CLASSES = {
    "frame_tracker": "FrameTrackerNode",
    "endpoint_poses": "EndpointPosesNode",
    "reproduction": "ReproductionNode",
    "joint_reference": "JointReferenceNode",
    "impedance_controller": "ImpedanceControllerNode",
    "joint_motion": "JointMotionNode",
    "baxter_simulator": "BaxterSimulatorNode",
}


def main(args: list[str] | None = None) -> int:
    """Run the nodes that the arguments name; returns the exit status."""
    args = sys.argv if args is None else args
    parser = _parser()
    names = parser.parse_args(remove_ros_args(args)[1:]).nodes
    if twice := sorted({name for name in names if names.count(name) > 1}):
        parser.error(f"{listed(twice)} given twice; a process can run each node once")
    classes = [getattr(import_module(f"tpgmm_ros.nodes.{name}"), CLASSES[name]) for name in names]
    return run_together(classes, args)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="compose",
        usage="%(prog)s [-h] NODE [NODE ...] [--ros-args ...]",
        description=__doc__,
        epilog="Each node's own --help lists its parameters.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("nodes", metavar="NODE", nargs="+", choices=CLASSES, help=f"nodes to run: {', '.join(CLASSES)}")
    return parser


if __name__ == "__main__":
    sys.exit(main())
