# SPDX-License-Identifier: Apache-2.0
"""Run the experiment of Figure 5: ``python -m tpgmm_demos.figure5``."""

import sys

from tpgmm_demos.figure5.main import main

sys.exit(main())
