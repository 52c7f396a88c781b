# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model_parts import read_parts, write_parts
from tpgmm_core import TPGMM, Frame, ModelFileError
from tpgmm_core.learning import model_file
from workloads import pose_demonstrations


@pytest.fixture(scope="module")
def model() -> TPGMM:
    fitted = TPGMM(3, manifold="R1 x R3 x S3", reg_covar=1e-5).fit(pose_demonstrations(2, n_samples=40))
    fitted.dimensions_ = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
    fitted.metadata_ = {"duration_s": 12.5, "source": "two demonstrations, änd ünicode"}
    return fitted


@pytest.fixture
def path(model: TPGMM, tmp_path: Path) -> Path:
    model.save(tmp_path / "pick.tpgmm")
    return tmp_path / "pick.tpgmm"


def test_a_model_comes_back_as_it_was(model: TPGMM, path: Path) -> None:
    loaded = TPGMM.load(path)
    for name in ("priors_", "log_likelihoods_", "objectives_"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(model, name))
    assert loaded.frame_names_ == model.frame_names_ and loaded.manifold_ == model.manifold_
    for name in model.frame_names_:
        np.testing.assert_array_equal(loaded.means_[name], model.means_[name])
        np.testing.assert_array_equal(loaded.covariances_[name], model.covariances_[name])
    for name in ("dimensions_", "metadata_", "n_iter_", "converged_", "log_likelihood_"):
        assert getattr(loaded, name) == getattr(model, name)
    assert loaded.get_params() == model.get_params()
    frames = pose_demonstrations(1, seed=3)[0].frames
    np.testing.assert_array_equal(loaded.adapt(frames).means, model.adapt(frames).means)


def test_frames_of_different_dimensions_and_a_fitted_init_can_be_saved(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    X = {"a/b ä": rng.normal(size=(30, 2)), "c": rng.normal(size=(30, 4))}
    start = TPGMM(2, init="bins").fit_projected(X)
    fitted = TPGMM(2, init=start, random_state=np.random.default_rng(1)).fit_projected(X)
    fitted.save(tmp_path / "m.tpgmm")
    loaded = TPGMM.load(tmp_path / "m.tpgmm")
    assert loaded.means_["a/b ä"].shape == (2, 2) and loaded.init == "time"
    mixture = loaded.adapt({"c": Frame(np.eye(4), np.zeros(4))})
    assert mixture.means.shape == (2, 4)


def test_arrays_that_are_stored_column_by_column_are_read_as_they_are(model: TPGMM, path: Path) -> None:
    _, arrays = read_parts(path)
    rewrite(
        path, means_1=np.asfortranarray(arrays["means_1"]), covariances_0=np.asfortranarray(arrays["covariances_0"])
    )
    with zipfile.ZipFile(path) as archive:
        assert b"'fortran_order': True" in archive.read("means_1.npy")
    loaded = TPGMM.load(path)
    names = model.frame_names_
    np.testing.assert_array_equal(loaded.means_[names[1]], model.means_[names[1]])
    np.testing.assert_array_equal(loaded.covariances_[names[0]], model.covariances_[names[0]])


def test_saving_replaces_whole_files_only(model: TPGMM, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_bytes()

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            model.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_metadata_must_be_texts_and_finite_numbers(path: Path) -> None:
    loaded = TPGMM.load(path)
    for value in (None, [1.0], float("nan"), {"a": 1}):
        loaded.metadata_ = {"key": value}  # type: ignore[dict-item]
        with pytest.raises(ValueError, match="metadata"):
            loaded.save(path)
    assert TPGMM.load(path).metadata_["duration_s"] == 12.5


def test_a_missing_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        TPGMM.load(tmp_path / "none.tpgmm")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"not a model", b"\x80\x04K*.", bytes(1000)])
def test_foreign_files_give_one_clear_error(content: bytes, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.tpgmm"
    foreign.write_bytes(content)
    with pytest.raises(ModelFileError, match="foreign.tpgmm"):
        TPGMM.load(foreign)


def test_pickles_are_not_executed(tmp_path: Path) -> None:
    bad = tmp_path / "bad.tpgmm"
    with open(bad, "wb") as stream:
        np.savez(stream, **{"model.json": np.array([print], dtype=object)})
    with pytest.raises(ModelFileError, match="bad.tpgmm"):
        TPGMM.load(bad)


def test_a_file_that_would_unpack_to_too_much_is_refused_before_unpacking(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_file, "MAX_BYTES", 1000)
    with pytest.raises(ModelFileError, match="at most 1000"):
        TPGMM.load(path)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_gives_a_clear_error_or_the_same_model(path: Path, data: st.DataObject) -> None:
    original = TPGMM.load(path)
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 5))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    damaged = path.with_name("damaged.tpgmm")
    damaged.write_bytes(content)
    try:
        loaded = TPGMM.load(damaged)
    except ModelFileError as error:
        assert "damaged.tpgmm" in str(error)
    else:
        np.testing.assert_array_equal(loaded.priors_, original.priors_)
        for name in original.frame_names_:
            np.testing.assert_array_equal(loaded.means_[name], original.means_[name])


def rewrite(path: Path, **changes: Any) -> None:
    """Change the header or arrays of a model file, keeping it a sound archive."""
    header, arrays = read_parts(path)
    for key, value in changes.items():
        (arrays if key in arrays else header)[key] = value
    write_parts(path, header, arrays)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "not a model file"),
        ({"version": 99}, "version 99"),
        ({"frames": ["object", "object", "robot"]}, "distinct"),
        ({"frames": []}, "distinct"),
        ({"manifold": "R1 x R3"}, "expected"),
        ({"manifold": "cone"}, "cone"),
        ({"dimensions": ["time"]}, "8 names"),
        ({"metadata": [1]}, "metadata"),
        ({"settings": 3}, "not a model file"),
        ({"priors": np.array([0.5, 0.6, 0.7])}, "sum to 1"),
        ({"priors": np.array([0.5, 0.5])}, "expected"),
        ({"means_0": np.full((3, 8), np.nan)}, "finite"),
        ({"means_0": np.zeros((3, 8), dtype=np.int64)}, "float64"),
        ({"covariances_1": np.zeros((3, 7, 7))}, "damaged"),
    ],
)
def test_inconsistent_contents_are_refused_with_the_reason(path: Path, changes: dict[str, Any], message: str) -> None:
    rewrite(path, **changes)
    with pytest.raises(ModelFileError, match=message):
        TPGMM.load(path)


def test_archives_with_missing_parts_are_refused(path: Path) -> None:
    kept = io.BytesIO()
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(kept, "w") as smaller:
        for name in archive.namelist():
            if name != "means_1.npy":
                smaller.writestr(name, archive.read(name))
    path.write_bytes(kept.getvalue())
    with pytest.raises(ModelFileError, match="means_1"):
        TPGMM.load(path)
