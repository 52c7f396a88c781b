# SPDX-License-Identifier: Apache-2.0
"""Files of bags, in the order in which they were written. What is not asked for is skipped, and never parsed."""
