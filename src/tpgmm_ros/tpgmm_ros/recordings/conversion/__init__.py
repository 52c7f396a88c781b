# SPDX-License-Identifier: Apache-2.0
"""Arrays of other programs (CSV, numpy, MATLAB, LeRobot) become bags, and bags LeRobot datasets."""
