# SPDX-License-Identifier: Apache-2.0
"""Recognition: which of several known skills is being shown, where its hand goes next, and what a recording holds."""
