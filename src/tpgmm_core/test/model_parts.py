# SPDX-License-Identifier: Apache-2.0
"""Model files taken apart and put together again, for tests of what is no sound model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np


def read_parts(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a model file."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return json.loads(arrays.pop("model.json").tobytes()), arrays


def write_parts(path: Path, header: Any, arrays: dict[str, Any]) -> Path:
    """A sound archive of whatever header and arrays."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    with path.open("wb") as stream:
        np.savez(stream, **{"model.json": np.frombuffer(text, dtype=np.uint8)}, **arrays)
    return path
