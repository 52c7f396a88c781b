# SPDX-License-Identifier: Apache-2.0
"""Fixtures for the tests of all packages."""

import signal

pytest_plugins = ["ros_testing"]

# A shell that runs tests in the background ignores Ctrl-C for them, and so would every process that they start
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
