# SPDX-License-Identifier: Apache-2.0
"""A project without ROS and without a page: what was taught, what was learned from it, what may be done now."""
