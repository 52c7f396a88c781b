# SPDX-License-Identifier: Apache-2.0
"""What the program of frames as a tensor judges by: frames that are superfluous, models from its parts."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from examples import frame_tensor
from tpgmm_core import Demonstration, Frame
from tpgmm_core.geometry import quaternion
from tpgmm_core.retrieval.recipe import Recipe

IS_INSTALLED = find_spec("tensorly") is not None


@pytest.fixture(scope="module")
def shown() -> list[Demonstration]:
    """From one box to another, both anywhere and turned; a third frame is fixed to the second one."""
    rng, times = np.random.default_rng(3), np.linspace(0.0, 1.0, 20)
    demonstrations = []
    for _ in range(7):
        first, second = rng.normal(size=(2, 3))
        path = first + np.outer(times, second - first) + 0.01 * rng.normal(size=(20, 3))
        frames = {}
        for name, place in (("first", first), ("second", second)):
            R = quaternion.rotation_matrix(quaternion.normalize(rng.normal(size=4)))
            frames[name] = Frame(R, place).with_time()
        shown = Demonstration(times, np.column_stack([times, path]), frames)
        demonstrations.append(frame_tensor.with_twin(shown, "second"))
    return demonstrations


def test_a_frame_that_is_fixed_to_another_one_is_redundant(shown: list[Demonstration]) -> None:
    shares = frame_tensor.explained(frame_tensor.views(shown))
    np.testing.assert_allclose(np.diag(shares), 1.0)
    assert shares[1, 2] > 0.999 and shares[2, 1] > 0.999
    assert shares[0, 1:].max() < 0.9
    assert frame_tensor.redundant(list(shown[0].frames), shares) == {"second (twin)": "second"}


def test_of_three_that_are_the_same_the_first_stays() -> None:
    shares = np.array([[1.0, 0.2, 1.0, 1.0], [0.1, 1.0, 0.1, 0.1], [1.0, 0.2, 1.0, 1.0], [0.995, 0.2, 1.0, 1.0]])
    assert frame_tensor.redundant(list("abcd"), shares) == {"c": "a", "d": "a"}
    shares[3, 0] = 0.5  # d does not tell what a sees
    assert frame_tensor.redundant(list("abcd"), shares) == {"c": "a"}


@pytest.mark.skipif(not IS_INSTALLED, reason="TensorLy is optional")
def test_a_model_from_all_parts_of_its_tensor_is_that_model(shown: list[Demonstration]) -> None:
    model = Recipe.of({"n_steps": 20}, "time_steps").learn(shown, "R1 x R3")
    same, _, _ = frame_tensor.compressed(model, 1.0)
    smaller, numbers, before = frame_tensor.compressed(model, 0.9)
    assert numbers < 0.6 * before
    for name in model.frame_names_:
        np.testing.assert_allclose(same.means_[name], model.means_[name], atol=1e-6)
        np.testing.assert_allclose(same.covariances_[name], model.covariances_[name], rtol=1e-4, atol=1e-9)
        np.linalg.cholesky(smaller.covariances_[name])


@pytest.mark.skipif(IS_INSTALLED, reason="TensorLy is there")
def test_without_tensorly_the_program_says_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    assert frame_tensor.main([]) == 1
    assert "pip install tensorly" in capsys.readouterr().err
