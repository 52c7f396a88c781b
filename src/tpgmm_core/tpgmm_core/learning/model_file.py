# SPDX-License-Identifier: Apache-2.0
"""Model files: one file of numbers and text, versioned; loading executes nothing.

A file is a zip archive in numpy's npz format: `model.json` as an array of bytes with the names, texts and
settings, and plain numeric arrays. It is replaced as a whole (`atomic_file`): an
interrupted save loses nothing.

A file may be untrusted: the sizes that it announces are compared with limits and with what it contains, before memory
is reserved for it.
"""

from __future__ import annotations

import io
import math
import os
import stat
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.text import one_line, shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.covariance.structure import Covariances, Structure
from tpgmm_core.learning.covariance.structures import covariances_class
from tpgmm_core.learning.model_header import ModelFileError, ModelHeader

MAX_BYTES = 100_000_000  # unpacked; a model of 100 components, 20 frames and 20 dimensions has 7 MB
MAX_HEADER_BYTES = 1_000_000  # of model.json
MAX_MEMBERS = 10_000
MAX_COMPONENTS = 10_000
MAX_NUMBERS = MAX_BYTES // 8
"""Limit of all dense covariances together: structures of few numbers are small in the file and large in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelContents:
    """What a model file holds: its header, and the arrays that are named like the attributes of `TPGMM`.

    frames are the covariances in their structure, where it is not "full": then the file holds these, not the dense
    ones; more are the arrays that a kind of model has beyond those of `TPGMM`.
    """

    header: ModelHeader
    priors: Array
    means: Mapping[str, Array]
    covariances: Mapping[str, Array]
    log_likelihoods: Array
    objectives: Array
    frames: Mapping[str, Covariances] | None = None
    more: Mapping[str, Array] = field(default_factory=dict)


def write(path: str | PathLike[str], contents: ModelContents) -> None:
    """Write a model file; an older one is replaced only when the new one is complete.

    Parameters
    ----------
    path
        the file
    contents
        what it will hold

    Raises
    ------
    ValueError
        when the metadata hold anything but texts and finite numbers
    OSError
        when the file cannot be written
    """
    arrays: dict[str, Any] = {
        "model.json": np.frombuffer(contents.header.to_json(), dtype=np.uint8),
        "priors": contents.priors,
        "log_likelihoods": contents.log_likelihoods,
        "objectives": contents.objectives,
    }
    arrays |= {f"more_{key}": array for key, array in contents.more.items()}
    for j, name in enumerate(contents.header.frames):
        arrays[f"means_{j}"] = contents.means[name]
        if contents.frames is None:
            arrays[f"covariances_{j}"] = contents.covariances[name]
        else:
            arrays |= {f"frame_{j}_{key}": array for key, array in contents.frames[name].arrays().items()}

    def fill(draft: Path) -> None:
        with draft.open("wb") as stream:  # a name would be given the ending .npz
            np.savez_compressed(stream, **arrays)

    write_atomically(path, fill)


def read(path: str | PathLike[str]) -> ModelContents:
    """Read a model file.

    Parameters
    ----------
    path
        the file

    Returns
    -------
    ModelContents
        what the file holds, checked

    Raises
    ------
    ModelFileError
        for anything but a complete model file of a known version
    FileNotFoundError
        where there is none
    """
    return read_as(path, lambda contents: contents)


def read_as[T](path: str | PathLike[str], make: Callable[[ModelContents], T]) -> T:
    """Read a model file once, and make something of its contents.

    Parameters
    ----------
    path
        the file
    make
        makes it; what it raises counts as a damaged file

    Returns
    -------
    T
        what `make` made

    Raises
    ------
    ModelFileError
        for anything but a complete model file of a known version, and where `make` refuses the contents
    """
    try:
        arrays = _arrays(path)
        return make(_contents(ModelHeader.from_json(arrays.pop("model.json").tobytes()), arrays))
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except ModelFileError as error:
        raise ModelFileError(f"{one_line(path)}: {error}") from None
    except Exception as error:  # zip, numpy and json raise many errors for damaged bytes: the caller gets one
        raise ModelFileError(
            f"{one_line(path)}: damaged, or not a model file ({type(error).__name__}: {one_line(error, 300)}); "
            "train the model again"
        ) from error


def _arrays(path: str | PathLike[str]) -> dict[str, Any]:
    """The arrays of the archive by name, as many and as large as a model file may have."""
    status = os.stat(path)
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(f"{path} is a folder, expected a model file")
    if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_BYTES:
        raise ModelFileError(f"no regular file of at most {MAX_BYTES} bytes")
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > MAX_BYTES or len(members) > MAX_MEMBERS:
            raise ModelFileError(
                f"{size} bytes unpacked in {len(members)} members, a model file has at most {MAX_BYTES} in "
                f"{MAX_MEMBERS}"
            )
        # zipfile unpacks no more of a member than the size that is announced
        arrays = {m.filename.removesuffix(".npy"): _array(m.filename, archive.read(m)) for m in members}
    if arrays["model.json"].nbytes > MAX_HEADER_BYTES:
        raise ModelFileError(f"model.json has more than {MAX_HEADER_BYTES} bytes")
    return arrays


def _array(name: str, content: bytes) -> Any:
    """A numeric array in numpy's npy format. numpy's own reader takes the memory that the file announces first."""
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, is_fortran, dtype = read_header(stream)
    if dtype not in (np.float64, np.uint8):
        raise ModelFileError(f"{name} must be finite float64 numbers, got {dtype}")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise ModelFileError(f"{name} declares the shape {shape}, but holds {len(content) - stream.tell()} bytes")
    flat = np.frombuffer(content, dtype, offset=stream.tell())
    return flat.reshape(shape, order="F" if is_fortran else "C").copy()


def _contents(header: ModelHeader, arrays: dict[str, Any]) -> ModelContents:
    names, manifold = header.frames, header.manifold
    means = {name: _numbers(arrays, f"means_{j}", 2) for j, name in enumerate(names)}
    priors = _numbers(arrays, "priors", 1)
    K = len(priors)
    if K == 0 or priors.min() < 0.0 or not math.isclose(priors.sum(), 1.0, abs_tol=1e-6):
        raise ModelFileError("priors must be from 0 and sum to 1")
    if K > MAX_COMPONENTS:
        raise ModelFileError(f"{K} components, a model file has at most {MAX_COMPONENTS}")
    frames = None if header.structure is None else _frames(names, header.structure, arrays)
    covariances = {} if frames else {name: _numbers(arrays, f"covariances_{j}", 3) for j, name in enumerate(names)}
    n_numbers = 0
    for name in names:
        D = means[name].shape[1]
        space = Manifold.euclidean(D) if manifold.is_euclidean and D else manifold
        n = space.tangent_dim
        shape = (*frames[name].shape, n) if frames else covariances[name].shape
        if means[name].shape != (K, space.dim) or shape != (K, n, n):
            raise ModelFileError(
                f"frame {shown(name)} has means {means[name].shape} and covariances {shape}, "
                f"expected {(K, space.dim)} and {(K, n, n)}"
            )
        n_numbers += K * n * n
        if n_numbers > MAX_NUMBERS:
            raise ModelFileError(f"covariances of {n_numbers} numbers, a model file has at most {MAX_NUMBERS}")
        if frames:
            covariances[name] = frames[name].dense()
        np.linalg.cholesky(covariances[name])
    course = [_numbers(arrays, name, 1) for name in ("log_likelihoods", "objectives")]
    if not all(map(len, course)):
        raise ModelFileError(f"log_likelihoods and objectives have at least one number, got {[len(c) for c in course]}")
    more = {key.removeprefix("more_"): _numbers(arrays, key) for key in arrays if key.startswith("more_")}
    return ModelContents(header, priors, means, covariances, course[0], course[1], frames, more)


def _frames(names: Sequence[str], structure: Structure, arrays: dict[str, Any]) -> dict[str, Covariances]:
    """The covariances in their structure, whose class checks that its arrays fit together."""
    frames = {}
    for j, name in enumerate(names):
        prefix = f"frame_{j}_"
        own = {key.removeprefix(prefix): _numbers(arrays, key) for key in arrays if key.startswith(prefix)}
        for key, array in own.items():
            # some structures multiply their factors out when they are made
            if array.ndim == 3 and array.shape[0] * max(array.shape[1:]) ** 2 > MAX_NUMBERS:
                raise ModelFileError(f"{prefix}{key} of shape {array.shape} declares more than {MAX_NUMBERS} numbers")
        frames[name] = covariances_class(structure).from_arrays(structure, own)
    return frames


def _numbers(arrays: dict[str, Any], name: str, ndim: int | None = None) -> Array:
    array = arrays[name]
    if array.dtype != np.float64 or ndim not in (None, array.ndim) or not np.all(np.isfinite(array)):
        raise ModelFileError(f"{name} must be finite float64 numbers" + (f" of {ndim} axes" if ndim else ""))
    return np.asarray(array)
