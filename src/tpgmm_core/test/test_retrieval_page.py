# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "retrieval.md"


@pytest.mark.skipif(not PAGE.exists(), reason="the package is tested without the repository's docs/")
def test_the_examples_run_as_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(examples) > 1
    names: dict[str, Any] = {}
    for example in examples:  # each uses what those before it made
        exec(compile(example, str(PAGE), "exec"), names)
