# SPDX-License-Identifier: Apache-2.0
"""Programs that start nodes: on a domain of their own, and no node outlives them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ros_graph import ROBOT_FILE

PROGRAM = """
import os, sys
from pathlib import Path
from tpgmm_ros.runtime.graph import open_graph, own_domain

with own_domain(), open_graph("program", Path(sys.argv[1])) as graph:
    graph.processes.start("impedance_controller", robot_file=sys.argv[2])
    graph.bring_up("impedance_controller", 60.0)
    print(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"], graph.processes.pid("impedance_controller"), flush=True)
    if sys.argv[3] == "interrupted":
        raise KeyboardInterrupt
"""


@pytest.mark.parametrize("end", ["done", "interrupted"])
def test_a_program_keeps_to_this_machine_and_its_nodes_end_with_it(end: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(tmp_path), str(ROBOT_FILE), end]
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOG_DIR": str(tmp_path)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert (run.returncode == 0) == (end == "done"), run.stderr
    profile, pid = run.stdout.split()
    assert Path(profile).name == "this_machine.xml"
    assert not Path(f"/proc/{pid}").exists()
    assert "active" in (tmp_path / "impedance_controller.log").read_text()
