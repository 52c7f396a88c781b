# SPDX-License-Identifier: Apache-2.0
"""Types that every module uses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Nanoseconds = NDArray[np.int64]
