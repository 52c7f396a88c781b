# SPDX-License-Identifier: Apache-2.0
"""Quaternions, manifolds, affine frames, Gaussians and their mixtures, with the compiled loops beneath them."""
