# SPDX-License-Identifier: Apache-2.0
"""Texts as a page may show them: names of files and folders, and not where on this machine they lie.

Other machines may see the page, and what is said there comes from everywhere: refusals, errors of the operating system,
what nodes say of themselves. The log has the same texts as they are.
"""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path


@cache
def _paths() -> re.Pattern[str]:
    """Absolute paths of this machine: those below a folder of its root. Names of topics, addresses, tags are none."""
    known = {str(place) for place in (Path.home(), Path.cwd())} - {"/"}  # their names may hold blanks
    roots = [entry.path for entry in os.scandir("/") if entry.is_dir()]
    begin = "|".join(re.escape(place) for place in sorted(known, key=len, reverse=True) + sorted(roots))
    return re.compile(rf"(?<![\w.:/<~-])(?:{begin})(?=/)(?:/[^\s/'\"<>&;,:)]*)*/(?=[^\s/'\"<>&;,:)])")


def names_alone(text: str) -> str:
    """A text, or HTML, with the last name of each absolute path in it alone.

    Parameters
    ----------
    text
        as it was said

    Returns
    -------
    str
        the same without the folders: "/home/ana/cups is no project" becomes "cups is no project"
    """
    return _paths().sub("", text)
