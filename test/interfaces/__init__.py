# SPDX-License-Identifier: Apache-2.0
"""Robots with different interfaces, each a process that checks the contract of its interface, in one task."""
