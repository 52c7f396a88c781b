# SPDX-License-Identifier: Apache-2.0
import sys

from tpgmm_demos.figure5.main import main

sys.exit(main())
