# SPDX-License-Identifier: Apache-2.0
"""Numbers with one value everywhere."""

from __future__ import annotations

import math

LOG_2PI = math.log(2.0 * math.pi)
RANK_TOLERANCE = 1e-10  # singular values below this share of the largest count as zero
ORTHOGONAL = 1e-14  # A^T A differs from I by less than this: by rounding
SINGULAR = 1e-14  # a variance, given the dimensions before, that is a smaller share of the whole one is rounding

SHORTEST_QUATERNION = 1e-9
"""Norm below which a quaternion is no orientation."""

UNIT_ROUNDING = 4.0 * 2.220446049250313e-16
"""How far the norm of a unit quaternion is from 1 by rounding."""
