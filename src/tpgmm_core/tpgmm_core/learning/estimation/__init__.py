# SPDX-License-Identifier: Apache-2.0
"""Expectation-maximisation: starts, responsibilities, moments, when to stop."""
