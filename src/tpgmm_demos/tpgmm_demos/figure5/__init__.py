# SPDX-License-Identifier: Apache-2.0
"""figure5: a cup held level and a sugar cube above it, taught separately and done together (Figure 5 of the paper).

Teaches both tasks to a simulated Baxter, each by one short recorded demonstration, learns a single Gaussian in each of
several candidate frames, and lets the LQR of their product move both arms, while the robot is pushed: the cup alone,
the sugar alone, the left hand pushed while the right one follows, and both tasks together.
"""

from tpgmm_demos.figure5.main import main

__all__ = ["main"]
