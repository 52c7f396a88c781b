# SPDX-License-Identifier: Apache-2.0
"""Untrusted model files: whatever is in them, they are refused in words, or work.

`make test` tries some files, `make fuzz` (TPGMM_FUZZ_EXAMPLES=20000) as many as it says.
"""

from __future__ import annotations

import math
import os
import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model_parts import read_parts, write_parts
from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, ModelFileError
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.incremental.online import OnlineTPGMM
from tpgmm_core.retrieval.methods import ALL_METHODS, load_model, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe
from wiping import shown_for

EXAMPLES = int(os.environ.get("TPGMM_FUZZ_EXAMPLES", "100"))
FUZZ = settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
MANIFOLD = Manifold.parse("R1 x R3 x S3")
DIMENSIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
START = place(0.02, -0.03, 0.2)
SITUATION = frames_at(start=START, object=place(0.5, 0.02, -0.2))
STRUCTURES = ("diag", "mfa", "semi_tied", "hddc", "deep_mfa")

_NUMBERS = st.sampled_from([0.0, -1.0, 1.0, 1e-300, 1e-12, 1e12, 1e154, 1e300, math.nan, math.inf, -math.inf])
_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | _NUMBERS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=6,
)


@cache
def sound(kind: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a sound model: of each method, each structure, and one that goes on learning."""
    demonstrations = reaching_demonstrations(4)
    if kind in ALL_METHODS:
        recipe = Recipe.of({"n_components": 2, "reg_covar": 1e-4, "retrieval": kind, "max_iter": 5})
        model = recipe.learn(shown_for(kind, demonstrations), MANIFOLD, DIMENSIONS)
    elif kind == "online":
        model = OnlineTPGMM(2, manifold=MANIFOLD, reg_covar=1e-4, max_iter=5).fit(demonstrations)
    else:
        model = TPGMM(2, manifold=MANIFOLD, reg_covar=1e-4, max_iter=5, covariance=kind).fit(demonstrations)
    model.metadata_ = {"duration_s": 1.0, **model.metadata_}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sound.tpgmm"
        model.save(path)
        return read_parts(path)


@st.composite
def broken(draw: st.DrawFn) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """A sound model in which something was changed."""
    kind = draw(st.sampled_from([*ALL_METHODS, *STRUCTURES, "online"]))
    header, arrays = sound(kind)
    header, arrays = dict(header), dict(arrays)
    for _ in range(draw(st.integers(1, 3))):
        if draw(st.booleans()):
            _change_header(draw, header)
        else:
            _change_array(draw, arrays)
    return kind, header, arrays


def _change_header(draw: st.DrawFn, header: dict[str, Any]) -> None:
    key = draw(st.sampled_from(sorted(header)))
    if isinstance(header[key], dict) and header[key] and draw(st.booleans()):
        inner = draw(st.sampled_from(sorted(header[key])))
        header[key] = {**header[key], inner: draw(_NUMBERS | _JSON)}
    elif draw(st.integers(0, 4)) == 0:
        del header[key]
    else:
        choices = ["R8", "R999999999", "S3 x S3", "TPHSMM", "EndpointTPGMM", "OnlineTPGMM", "euclidean", ["object"]]
        header[key] = draw(st.sampled_from(choices) | _JSON)


def _change_array(draw: st.DrawFn, arrays: dict[str, Any]) -> None:
    if not arrays:
        return
    key = draw(st.sampled_from(sorted(arrays)))
    array = arrays[key]
    if array.dtype != np.float64:  # changed before
        return
    what = draw(st.sampled_from(["number", "scale", "shape", "cut", "kind", "drop", "swap"]))
    if what == "number" and array.size:
        array = array.copy()
        array.flat[draw(st.integers(0, array.size - 1))] = draw(_NUMBERS)
    elif what == "scale":
        with np.errstate(all="ignore"):
            array = array * draw(_NUMBERS)
    elif what == "shape":
        array = np.full(draw(st.lists(st.integers(0, 4), max_size=4)), draw(_NUMBERS))
    elif what == "cut" and array.ndim:
        array = array[draw(st.integers(0, array.shape[0])) :]
    elif what == "kind":
        with np.errstate(all="ignore"):
            array = array.astype(draw(st.sampled_from(["f4", "i8", "c16", "S8", "?", ">f8"])))
    arrays[key] = array
    if what == "drop":
        del arrays[key]
    elif what == "swap":
        arrays[key] = arrays[draw(st.sampled_from(sorted(arrays)))]


@FUZZ
@given(broken())
def test_whatever_a_model_file_holds_it_is_refused_in_words_or_can_be_reproduced(
    parts: tuple[str, dict[str, Any], dict[str, Any]],
) -> None:
    kind, header, arrays = parts
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        path = write_parts(Path(folder) / "strange.tpgmm", header, arrays)
        try:
            model = OnlineTPGMM.load(path) if kind == "online" else load_model(path)
        except ModelFileError as error:
            assert "strange.tpgmm" in str(error) and len(str(error)) < 5000
            return
        try:
            retrieval = make_retrieval(model, horizon_steps=2)
            retrieval.start(0, START)
            for i in range(1, 4):
                reference = retrieval.step(i * 500_000_000, SITUATION, START)
                assert np.isfinite(reference.gaussian.mean).all() and np.isfinite(reference.gaussian.covariance).all()
            retrieval.mixture()
        except ValueError as error:
            assert str(error)


@FUZZ
@given(data=st.data())
def test_bytes_that_were_changed_give_a_clear_error_or_a_model(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write_parts(
            Path(folder) / "bytes.tpgmm", *sound(data.draw(st.sampled_from([*ALL_METHODS, *STRUCTURES])))
        )
        content = bytearray(path.read_bytes())  # not compressed: changes reach the headers of arrays
        for _ in range(data.draw(st.integers(1, 8))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
        path.write_bytes(content)
        try:
            load_model(path)
        except ModelFileError as error:
            assert "bytes.tpgmm" in str(error)


@pytest.mark.parametrize("kind", [*ALL_METHODS, *STRUCTURES, "online"])
def test_a_model_that_nobody_changed_is_read_and_reproduced(kind: str, tmp_path: Path) -> None:
    model = load_model(write_parts(tmp_path / "sound.tpgmm", *sound(kind)))
    retrieval = make_retrieval(model)
    retrieval.start(0, START)
    assert np.isfinite(retrieval.step(500_000_000, SITUATION, START).gaussian.mean).all()
