# SPDX-License-Identifier: Apache-2.0
import sys

from tpgmm_ros.demo.main import main

sys.exit(main())
