# SPDX-License-Identifier: Apache-2.0
"""`ModelHeader`: the texts and settings of a model file, checked as it is read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.text import shown
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.covariance.structure import Structure

FORMAT = "tpgmm model"
VERSION = 2  # 2 knows structures and kinds; a mixture of full covariances is written as 1
MAX_DIMENSIONS = 10_000


class ModelFileError(ValueError):
    """The file is damaged, is no model file, or is of a later version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelHeader:
    """The names, texts and settings of a model: `model.json` of its file. See the attributes of `TPGMM`.

    Attributes
    ----------
    kind : str
        Class of the estimator.
    frames : tuple of str
        Names, in the order in which the arrays are numbered.
    manifold : Manifold
        Space of the data.
    dimensions : tuple of str, or None
        Names of the ambient numbers.
    converged : bool
        Whether EM ended by itself.
    settings : mapping
        Constructor arguments.
    metadata : mapping
        Texts and finite numbers by name.
    structure : Structure, or None
        Of the covariances, where it is not "full".
    """

    kind: str = "TPGMM"
    frames: tuple[str, ...]
    manifold: Manifold
    dimensions: tuple[str, ...] | None = None
    converged: bool = True
    settings: Mapping[str, str | float | None] = field(default_factory=dict)
    metadata: Mapping[str, str | float] = field(default_factory=dict)
    structure: Structure | None = None

    def to_json(self) -> bytes:
        """Write it as text. Raises ValueError for metadata that are something else than texts and finite numbers."""
        _check_metadata(self.metadata)
        version = 1 if self.structure is None and self.kind == "TPGMM" else 2
        texts = {field.name: getattr(self, field.name) for field in fields(self)} | {
            "manifold": str(self.manifold),
            "settings": dict(self.settings),
            "metadata": dict(self.metadata),
            "structure": None if self.structure is None else _texts_of(self.structure),
        }
        header = {"format": FORMAT, "version": version} | texts
        if self.structure is None:
            del header["structure"]
        return json.dumps(header, allow_nan=False).encode()

    @classmethod
    def from_json(cls, text: bytes) -> Self:
        """Read a header from text that may be untrusted; damaged text raises other errors as well.

        Parameters
        ----------
        text
            JSON

        Returns
        -------
        Self
            the header

        Raises
        ------
        ModelFileError
            for what is no header, or not one that this software reads
        """
        header = json.loads(text)
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise ModelFileError("not a model file: its header does not name the format")
        if header.get("version") not in range(1, VERSION + 1):
            raise ModelFileError(
                f"version {shown(header.get('version'))}, this software reads versions up to {VERSION}"
            )
        frames, dimensions, structure = header["frames"], header["dimensions"], header.get("structure")
        if not frames or not _is_names(frames) or len(set(frames)) != len(frames):
            raise ModelFileError(f"frames are distinct names, got {shown(frames)}")
        manifold = Manifold.parse(header["manifold"])
        if manifold.dim > MAX_DIMENSIONS:
            raise ModelFileError(f"the manifold has {manifold.dim} dimensions, a model file at most {MAX_DIMENSIONS}")
        if dimensions is not None and not (_is_names(dimensions) and len(dimensions) == manifold.dim):
            raise ModelFileError(f"dimensions: expected {manifold.dim} names, got {shown(dimensions)}")
        _check_metadata(header["metadata"])
        # a setting that is not given, such as no random state, is None, and no fault
        _check_metadata({key: value for key, value in dict(header["settings"]).items() if value is not None})
        if structure is not None:
            structure = Structure(**structure | {"layers": tuple(map(tuple, structure["layers"]))})
        return cls(
            kind=current_name(str(header.get("kind", "TPGMM"))),
            frames=tuple(frames),
            manifold=manifold,
            dimensions=None if dimensions is None else tuple(dimensions),
            converged=bool(header["converged"]),
            settings=dict(header["settings"]),
            metadata=dict(header["metadata"]),
            structure=structure,
        )


def _texts_of(structure: Structure) -> dict[str, Any]:
    """Its settings; what earlier versions do not know is there only where it counts."""
    settings = asdict(structure)
    if not structure.fixed_bases:
        del settings["fixed_bases"]
    return settings


def _is_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _check_metadata(metadata: Any) -> None:
    if not isinstance(metadata, Mapping):
        raise ValueError(f"metadata is a mapping from names to texts and numbers, got {shown(metadata)}")
    for key, value in metadata.items():
        is_number = isinstance(value, int | float) and abs(value) < 1e300  # larger integers have no float
        if not isinstance(key, str) or not (isinstance(value, str) or is_number):
            raise ValueError(f"metadata maps names to texts and finite numbers, got {shown(key)}: {shown(value)}")
