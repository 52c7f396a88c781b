# SPDX-License-Identifier: Apache-2.0
"""What the page shows in space: robot, frames, Gaussians, reference."""
