# SPDX-License-Identifier: Apache-2.0
"""`ProjectError`: why something cannot be done with a project, in words for the user."""

from __future__ import annotations


class ProjectError(ValueError):
    """What was given, what was expected, and what to do."""
