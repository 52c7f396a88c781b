# SPDX-License-Identifier: Apache-2.0
"""Fixtures for the tests of all packages."""

import os
import signal

from hypothesis import settings

pytest_plugins = ["ros_testing"]

# A shell that runs tests in the background ignores Ctrl-C for them, and so would every process that they start
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# `make test` tries the same examples each time, so that its verdict is that of the code alone; other ones are tried by
# `make fuzz` and `make properties`. How long one takes depends on what else the machine does
settings.register_profile("any", deadline=None)
settings.load_profile("any")
settings.register_profile("repeatable", deadline=None, derandomize=True)
if not {"TPGMM_FUZZ_EXAMPLES", "TPGMM_PROPERTY_SEQUENCES"} & os.environ.keys():
    settings.load_profile("repeatable")
