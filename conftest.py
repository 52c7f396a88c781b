# SPDX-License-Identifier: Apache-2.0
"""Fixtures for the tests of all packages."""

pytest_plugins = ["ros_testing"]
