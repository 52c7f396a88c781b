# SPDX-License-Identifier: Apache-2.0
"""Linear quadratic regulators: infinite, finite and receding horizons, in continuous and discrete time."""
