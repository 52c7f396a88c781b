# SPDX-License-Identifier: Apache-2.0
"""Run the demo: ``python -m tpgmm_demos.demo``."""

import sys

from tpgmm_demos.demo.main import main

sys.exit(main())
