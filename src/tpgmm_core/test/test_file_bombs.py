# SPDX-License-Identifier: Apache-2.0
"""Small files that stand for more memory than there is: refused by a process that has little of it."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib import format as npy

from model_parts import read_parts, write_parts
from tpgmm_core import TPGMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.model_file import MAX_BYTES
from workloads import pose_demonstrations

MEMORY = 600_000_000
"""What a process may take beyond what it has after its imports: some times what a model file may have, bytes."""

READ = f"""
import json, resource, sys
from tpgmm_core.learning.model_file import ModelFileError
from tpgmm_core.retrieval.methods import load_model
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + {MEMORY}
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
answers = {{}}
for path in sys.argv[1:]:
    try:
        load_model(path)
        answers[path] = "taken"
    except ModelFileError as error:
        answers[path] = "refused: " + str(error)
print(json.dumps(answers))
"""


def announced(shape: tuple[int, ...], content: bytes = b"") -> bytes:
    """An npy member that announces a shape, and holds something else."""
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue() + content


def with_member(path: Path, name: str, content: bytes, count: int = 1) -> None:
    """Replace a member of the archive, or add many."""
    with zipfile.ZipFile(path) as archive:
        members = {member: archive.read(member) for member in archive.namelist() if member != name}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, old in members.items():
            archive.writestr(member, old)
        for i in range(count):
            archive.writestr(name if count == 1 else f"{i}{name}", content)


def understate(path: Path, size: int) -> None:
    """Say in the archive's directory that members of a size are small."""
    content = path.read_bytes()
    assert content.count(size.to_bytes(4, "little")) >= 1
    path.write_bytes(content.replace(size.to_bytes(4, "little"), (1000).to_bytes(4, "little")))


def structured(path: Path, K: int, n: int, arrays: dict[str, Any], structure: str) -> None:
    """One frame of R^n whose covariances have a structure of few numbers."""
    header = read_parts(path)[0]
    settings = {"name": structure, "layers": [[2, 1]]}
    header |= {"frames": ["a"], "manifold": f"R{n}", "dimensions": None, "structure": settings, "version": 2}
    rest = {"priors": np.full(K, 1.0 / K), "means_0": np.zeros((K, n)), "log_likelihoods": np.zeros(1)}
    rest["objectives"] = np.zeros(1)
    write_parts(path, header, rest | {f"frame_0_{key}": array for key, array in arrays.items()})


def unpacks_to_much(path: Path) -> None:
    with_member(path, "more_a.npy", bytes(2 * MAX_BYTES))


def unpacks_to_more_than_it_says(path: Path) -> None:
    with_member(path, "more_a.npy", bytes(2 * MAX_BYTES))
    understate(path, 2 * MAX_BYTES)


def announces_a_huge_array(path: Path) -> None:
    with_member(path, "priors.npy", announced((10**9, 10**6)))


def announces_more_than_an_integer_holds(path: Path) -> None:
    with_member(path, "priors.npy", announced((2**40, 2**40), bytes(64)))


def announces_a_negative_array(path: Path) -> None:
    with_member(path, "priors.npy", announced((-1, 3), bytes(24)))


def has_many_members(path: Path) -> None:
    with_member(path, "a.npy", b"", count=20_000)


def is_nested_deeply(path: Path) -> None:
    write_parts(path, b"[" * 900_000, read_parts(path)[1])


def has_a_long_header(path: Path) -> None:
    write_parts(path, b'"' + b"x" * 2_000_000 + b'"', read_parts(path)[1])


def lies_on_a_huge_manifold(path: Path) -> None:
    header, arrays = read_parts(path)
    write_parts(path, header | {"manifold": "R999999999", "dimensions": None}, arrays)


def has_few_factors_of_many_dimensions(path: Path) -> None:
    structured(path, 1, 9999, {"loadings": np.ones((1, 9999, 1)), "noise": np.ones((1, 9999))}, "mfa")


def has_many_dimensions_on_the_diagonal(path: Path) -> None:
    structured(path, 100, 9999, {"variances": np.ones((100, 9999))}, "diag")


def has_a_deep_layer_of_many_factors(path: Path) -> None:
    latent = {"latent_loadings": np.ones((2, 10**6, 1)), "latent_noise": np.ones((2, 10**6))}
    top = {"base": np.ones((2, 1, 10**6)), "noise": np.ones((2, 1)), "n_parents": np.ones(1)}
    structured(path, 2, 1, top | latent, "deep_mfa")


def has_many_components(path: Path) -> None:
    structured(path, 10**6, 1, {"variances": np.ones((10**6, 1))}, "diag")


def lasts_for_ever(path: Path) -> None:
    TPHSMM(3, manifold="R1 x R3 x S3", max_iter=1).fit(pose_demonstrations(2, n_samples=40)).save(path)
    header, arrays = read_parts(path)
    write_parts(path, header, arrays | {"more_max_duration": np.array([9.9e6])})


BOMBS = [
    unpacks_to_much,
    unpacks_to_more_than_it_says,
    announces_a_huge_array,
    announces_more_than_an_integer_holds,
    announces_a_negative_array,
    has_many_members,
    is_nested_deeply,
    has_a_long_header,
    lies_on_a_huge_manifold,
    has_few_factors_of_many_dimensions,
    has_many_dimensions_on_the_diagonal,
    has_a_deep_layer_of_many_factors,
    has_many_components,
    lasts_for_ever,
]


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What one process with little memory says to each of the files."""
    folder = tmp_path_factory.mktemp("bombs")
    sound = folder / "sound.tpgmm"
    TPGMM(3, manifold="R1 x R3 x S3", reg_covar=1e-5).fit(pose_demonstrations(2, n_samples=40)).save(sound)
    os.mkfifo(folder / "pipe.tpgmm")
    paths = [sound, folder / "pipe.tpgmm"]
    for bomb in BOMBS:
        paths.append(folder / f"{bomb.__name__}.tpgmm")
        shutil.copy(sound, paths[-1])
        bomb(paths[-1])
        assert paths[-1].stat().st_size < 0.5 * MAX_BYTES
    command = [sys.executable, "-c", READ, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    return {Path(path).stem: answer for path, answer in json.loads(done.stdout).items()}


@pytest.mark.parametrize("name", [bomb.__name__ for bomb in BOMBS] + ["pipe"])
def test_a_file_that_stands_for_too_much_is_refused_within_little_memory(name: str, answers: dict[str, str]) -> None:
    assert answers[name].startswith("refused: ") and f"{name}.tpgmm" in answers[name], answers[name]
    assert "MemoryError" not in answers[name] and len(answers[name]) < 1000


def test_a_sound_model_is_read_within_that_memory(answers: dict[str, str]) -> None:
    assert answers["sound"] == "taken"
