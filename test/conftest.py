# SPDX-License-Identifier: Apache-2.0
"""Fixtures that several files of tests across packages share."""

import pytest

pytest.register_assert_rewrite("reproduction_player")

from reproduction_player import inactive, model_file, models, player, process  # noqa: E402
from workbench_user import browser  # noqa: E402

__all__ = ["browser", "inactive", "model_file", "models", "player", "process"]
