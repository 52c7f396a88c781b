# SPDX-License-Identifier: Apache-2.0
"""What makes no sense in recordings, said before anything is learned from them. Pure functions of numbers."""
