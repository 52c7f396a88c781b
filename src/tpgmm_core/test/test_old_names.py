# SPDX-License-Identifier: Apache-2.0
"""Model files that hold the names of an earlier version: loaded, and reproduced as before."""

from pathlib import Path

import numpy as np
import pytest

from model_parts import read_parts, write_parts
from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core.common.old_names import RENAMED, current_name
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.methods import METHODS, load_model, make_retrieval, method_of
from tpgmm_core.retrieval.recipe import Recipe

START = place(0.02, -0.03, 0.2)
SITUATION = frames_at(start=START, object=place(0.5, 0.02, -0.2))
OLD_OF = {new: old for old, new in RENAMED.items()}


def references(path: Path) -> list[Reference]:
    retrieval = make_retrieval(load_model(path))
    retrieval.start(0, START)
    return [retrieval.step(i * 100_000_000, SITUATION, START) for i in range(5)]


@pytest.mark.parametrize("method", [name for name in METHODS if name in OLD_OF])
def test_a_model_file_with_old_names_is_reproduced_like_one_with_new_names(method: str, tmp_path: Path) -> None:
    recipe = Recipe.of({"n_components": 3, "reg_covar": 1e-5, "retrieval": method})
    recipe.learn(reaching_demonstrations(6), "R1 x R3 x S3").save(tmp_path / "new.tpgmm")
    header, arrays = read_parts(tmp_path / "new.tpgmm")
    for key in ("retrieval", "encoding"):
        header["metadata"][key] = OLD_OF.get(header["metadata"][key], header["metadata"][key])
    header["kind"] = OLD_OF.get(header["kind"], header["kind"])
    old = write_parts(tmp_path / "old.tpgmm", header, arrays)

    model = load_model(old)
    assert type(model) is METHODS[method].estimator and method_of(model).name == method
    for expected, found in zip(references(tmp_path / "new.tpgmm"), references(old), strict=True):
        np.testing.assert_array_equal(found.gaussian.mean, expected.gaussian.mean)
        np.testing.assert_array_equal(found.gaussian.covariance, expected.gaussian.covariance)


def test_old_names_are_none_of_the_present_ones() -> None:
    assert not RENAMED.keys() & RENAMED.values()
    assert all(current_name(current_name(old)) == current_name(old) for old in RENAMED)
    assert current_name("trajectory") == "trajectory"
