# SPDX-License-Identifier: Apache-2.0
import sys

from tpgmm_demos.demo.main import main

sys.exit(main())
