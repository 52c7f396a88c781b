# SPDX-License-Identifier: Apache-2.0
"""Hidden Markov and semi-Markov models whose states are seen from frames (Section 7)."""
