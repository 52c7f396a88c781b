# SPDX-License-Identifier: Apache-2.0
"""The executables of this package by their names, as setup.py lists them. Nothing here takes time to import."""

from tpgmm_ros.runtime.entry import node

workbench = node("tpgmm_workbench.workbench")
simulated_workbench = node("tpgmm_workbench.simulated")
