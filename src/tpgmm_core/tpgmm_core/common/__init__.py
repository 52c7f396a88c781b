# SPDX-License-Identifier: Apache-2.0
"""What every package uses: types, constants, texts, settings with ranges, files."""
