# SPDX-License-Identifier: Apache-2.0
"""Demonstrations on a simulated Baxter: they need tpgmm_ros, and no robot needs them."""
