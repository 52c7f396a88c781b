# SPDX-License-Identifier: Apache-2.0
"""Why something cannot be converted."""


class ConversionError(ValueError):
    """What cannot be converted; the text names the file, what was found, what was expected and what to do."""
