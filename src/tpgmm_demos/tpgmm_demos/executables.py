# SPDX-License-Identifier: Apache-2.0
"""The executables of this package by their names, as setup.py lists them. Nothing here takes time to import."""

from tpgmm_ros.runtime.entry import program

demo = program("tpgmm_demos.demo")
figure5 = program("tpgmm_demos.figure5")
scripted_lessons = program("tpgmm_demos.teaching.scripted_lessons")
