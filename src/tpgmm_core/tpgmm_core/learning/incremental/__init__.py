# SPDX-License-Identifier: Apache-2.0
"""Learning from new demonstrations without the old ones."""
