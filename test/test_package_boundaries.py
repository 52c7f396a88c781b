# SPDX-License-Identifier: Apache-2.0
"""Which package may import which."""

import pkgutil
import subprocess
import sys

import pytest

import tpgmm_core

NOT_IN_THE_CORE = ("rclpy", "rosbags", "tpgmm_msgs", "tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")


def imported_after(statement: str) -> set[str]:
    """Names of the modules that a fresh interpreter has loaded after `statement`."""
    program = f"import sys\n{statement}\nprint(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return set(run.stdout.split())


def test_no_module_of_the_core_imports_ros() -> None:
    modules = [module.name for module in pkgutil.walk_packages(tpgmm_core.__path__, "tpgmm_core.")]
    assert modules
    loaded = imported_after("import " + ", ".join(name for name in modules if not name.endswith("__main__")))
    assert loaded.isdisjoint(NOT_IN_THE_CORE)


def test_importing_the_core_does_not_import_the_robot() -> None:
    assert "pinocchio" not in imported_after("import tpgmm_core")


@pytest.mark.parametrize(
    "module", ["task.task_file", "nodes.frame_tracker", "nodes.joint_reference", "programs.show", "programs.record"]
)
def test_what_reads_a_task_file_waits_neither_for_optimisers_nor_for_movements(module: str) -> None:
    heavy = {"linalg", "special", "optimize", "interpolate", "ndimage", "cluster"}
    loaded = imported_after(f"import tpgmm_ros.{module}")
    assert loaded.isdisjoint({f"scipy.{name}" for name in heavy} | {"tpgmm_core.lqr.riccati", "matplotlib"})
