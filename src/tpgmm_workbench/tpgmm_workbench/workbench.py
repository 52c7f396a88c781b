# SPDX-License-Identifier: Apache-2.0
"""workbench: serve a page in the browser to teach a robot a skill and to run it: teach, train, preview, run.

It uses only topics, services and actions of the running nodes. The page is for this machine, or for other machines
whose users have a token. With a real robot, it records while you guide the arm by hand; with a simulation, you can also
drag the hand and the objects.
"""

from __future__ import annotations

import queue
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.executor import StopFlag, run
from tpgmm_ros.runtime.parameters import Declared, Parameters
from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.page.access import Access
from tpgmm_workbench.page.page import Page
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.scene.shapes import read_shapes

PARAMETERS = [
    Declared("project", "workbench", "Folder of the project; it is created if it does not exist", fixed=True),
    Declared("task_file", "", "Task file (YAML) of a new project", fixed=True),
    Declared("robot_file", "", "Robot file (YAML) of a new project", fixed=True),
    Declared(
        "simulated",
        False,
        "The robot is a simulation: its hand and its objects can be dragged on the page",
        fixed=True,
    ),
    Declared(
        "host",
        "127.0.0.1",
        "Address at which the page is served; with 0.0.0.0, users of other machines can open it with the token that is "
        "printed",
        fixed=True,
    ),
    Declared("port", 8080, "Port of the page; if it is taken, the next free one", 1024, 65535, fixed=True),
    Declared(
        "meshes", True, "Show the robot by its meshes; otherwise by simple shapes, which are drawn faster", fixed=True
    ),
    Declared(
        "seed",
        -1,
        "Random seed of the simulated objects' places; -1: different places each time",
        -1,
        2**31 - 1,
        fixed=True,
    ),
    Declared(
        "coach_force",
        0.0,
        "Force on the hand at which a correction begins by itself while the skill runs, N; for robots that measure "
        "joint torques or external_wrench; 0: only by the button",
        0.0,
        500.0,
        fixed=True,
    ),
    Declared("frame_rate", 30.0, "Largest rate at which the page is updated, Hz", 1.0, 30.0, fixed=True),
]


class WorkbenchNode(Node):
    """Works off what the page asks for, and lets it show what is known."""

    def __init__(self) -> None:
        super().__init__("workbench")
        parameters = Parameters(self, PARAMETERS)
        self._requests: queue.SimpleQueue[tuple[Callable[..., object], tuple[Any, ...]]] = queue.SimpleQueue()
        self._period = 1.0 / parameters["frame_rate"]
        project = self._project(parameters)
        seed = None if parameters["seed"] < 0 else int(parameters["seed"])
        self.desk = Desk(self, project, parameters["simulated"], seed, parameters["coach_force"])
        shapes = read_shapes(self.desk.robot.urdf, meshes=parameters["meshes"])
        for note in shapes.notes:
            self.get_logger().warning(note)
        access = Access(parameters["host"])
        self.page = Page(self.desk, self.ask, shapes, parameters["port"], access)
        # the log goes to files and to other nodes: a token does not
        address = self.page.address.partition("/?")[0]
        self.get_logger().info(f"project {one_line(project.folder)}; the page is at {address}")
        if access.token:
            print(f"the page is open to other machines; who has this address may move the robot: {self.page.address}")
            sys.stdout.flush()

    @staticmethod
    def _project(parameters: Parameters) -> Project:
        folder = Path(parameters.file("project"))
        if folder.is_dir() and any(folder.iterdir()):
            return Project.open(folder)
        return Project.create(folder, parameters.file("task_file"), parameters.file("robot_file"))

    def ask(self, method: Callable[..., object], *arguments: Any) -> None:
        """Have a method called by the node's own thread; from any thread."""
        self._requests.put((method, arguments))

    def loop(self, executor: Executor, stop: StopFlag) -> None:
        """Serve topics and the page until told to stop."""
        due = time.monotonic()
        while not stop.set:
            executor.spin_once(timeout_sec=min(0.01, max(0.0, due - time.monotonic())))
            self._obey()
            if time.monotonic() >= due:
                self.page.show(self.desk.look())
                due = max(due + self._period, time.monotonic() + 0.2 * self._period)

    def _obey(self) -> None:
        while True:
            try:
                method, arguments = self._requests.get_nowait()
            except queue.Empty:
                return
            try:
                method(*arguments)
            except (ValueError, OSError) as error:
                self.desk.say(one_line(error))

    def destroy_node(self) -> None:
        """End what goes on, in order."""
        if hasattr(self, "page"):
            self.page.close()
        if hasattr(self, "desk"):
            self.desk.close()
        super().destroy_node()


def main() -> int:
    """Run the node; returns the exit status."""
    return run(WorkbenchNode)


if __name__ == "__main__":
    sys.exit(main())
