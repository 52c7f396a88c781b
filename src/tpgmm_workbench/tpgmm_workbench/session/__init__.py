# SPDX-License-Identifier: Apache-2.0
"""What happens at the workbench now, without ROS and without a page: frames, the hand that is led, what is seen."""
