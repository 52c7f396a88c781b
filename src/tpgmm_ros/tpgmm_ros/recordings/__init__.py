# SPDX-License-Identifier: Apache-2.0
"""Recorded demonstrations: bags written, and read as arrays of one clock. Reading needs no ROS."""
