# SPDX-License-Identifier: Apache-2.0
"""demo: from recorded demonstrations to torques on a simulated Baxter, in one command.

Trains a model from the recordings, starts frame_tracker, reproduction, impedance_controller and baxter_simulator, lets
Baxter pick an object and place it on a target in a situation that was never demonstrated, pushes the object and hides
the target during the movement, and reports the result.
"""

from tpgmm_demos.demo.main import main

__all__ = ["main"]
