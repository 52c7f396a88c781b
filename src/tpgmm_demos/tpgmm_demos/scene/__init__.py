# SPDX-License-Identifier: Apache-2.0
"""What a demonstration has around the robot: where things lie, and how a camera sees them."""
