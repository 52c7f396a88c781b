# SPDX-License-Identifier: Apache-2.0
"""Robots: what a file says of them, their kinematics and dynamics by Pinocchio, and their simulation."""
