# SPDX-License-Identifier: Apache-2.0
"""Covariance structures: full to deep mixtures of factor analyzers (Section 4 of the paper)."""
