# SPDX-License-Identifier: Apache-2.0
"""Minimal intervention control (Section 5): the predicted variability becomes an optimal controller.

Modules are imported by name.
"""
