# SPDX-License-Identifier: Apache-2.0
"""Choosing what a model is learned with: frames, method, structure, components, by held-out reproduction."""
