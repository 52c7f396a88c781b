# SPDX-License-Identifier: Apache-2.0
"""The examples on the pages of docs/ run as they stand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.skipif(not DOCS.exists(), reason="the package is tested without the repository's docs/")
@pytest.mark.parametrize(
    "name",
    [
        *("explanation/control.md", "explanation/priorities.md", "how-to/learning.md", "how-to/retrieval.md"),
        *("how-to/skills-in-series.md", "how-to/skills-in-parallel.md"),
    ],
)
def test_the_examples_of_a_page_run_as_they_stand(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = DOCS / name
    examples = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert examples
    names: dict[str, Any] = {}
    for example in examples:  # each uses what those before it made
        exec(compile(example, str(page), "exec"), names)
