# SPDX-License-Identifier: Apache-2.0
"""What comes from outside, checked: streams and their stamps, joint states, frames that are seen or not."""
