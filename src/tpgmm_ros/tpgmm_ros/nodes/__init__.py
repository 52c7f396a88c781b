# SPDX-License-Identifier: Apache-2.0
"""The nodes, one module each, and what several of them share."""
