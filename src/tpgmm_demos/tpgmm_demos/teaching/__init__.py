# SPDX-License-Identifier: Apache-2.0
"""Scripted teachers: they lead a simulated robot by forces, as persons lead a real one by hand."""
