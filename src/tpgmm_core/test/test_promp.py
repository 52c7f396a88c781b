# SPDX-License-Identifier: Apache-2.0
"""Probabilistic movement primitives in the frames: their Gaussians over time, and what basis functions leave out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from reaching import DURATION, reaching_demonstrations
from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.promp import ProMPTPGMM, basis
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.retrieval.time_steps import TimeSteps
from worlds import planar_demonstrations

STILL = {"still": Frame(np.eye(2), np.zeros(2)).with_time()}


def shown(paths: Array) -> list[Demonstration]:
    """Of paths (m, T, 2), as one frame at the origin sees them."""
    times = np.linspace(0.0, 1.0, paths.shape[1])
    return [Demonstration(times, np.column_stack([times, path]), STILL) for path in paths]


def within_steps(model: TimeStepTPGMM) -> Array:
    """Covariances (T, 2, 2) at the steps of `model`, in the frame "still"."""
    S = model.covariances_["still"]
    return np.asarray(S[:, 1:, 1:] - S[:, 1:, 0, None] * S[:, None, 0, 1:] / S[:, 0, 0, None, None])


def test_basis_functions_add_up_to_one_and_tell_everything_apart() -> None:
    phi = basis(100, 20)
    np.testing.assert_allclose(phi.sum(axis=1), 1.0)
    assert np.linalg.cond(phi) < 100.0


def test_gaussians_are_those_of_the_weights() -> None:
    """Against the equations of the module, with the covariance of all weights written out."""
    rng = np.random.default_rng(0)
    m, B, c = 5, 6, 2.0
    w, phi = rng.normal(size=(m, B, 2)), basis(41, B)
    model = ProMPTPGMM(manifold="R1 x R2", reg_covar=0.0, prior_strength=c, n_steps=41, n_basis=B)
    model.fit(shown(np.einsum("tb,mbn->mtn", phi, w)))
    deviations = (w - w.mean(axis=0)).reshape(m, 2 * B)
    sample = deviations.T @ deviations / (m - 1)
    blocks = sample.reshape(B, 2, B, 2)
    alike = np.einsum("bidi->bd", blocks) / 2.0
    sigma = ((m - 1) * sample + c * np.kron(alike, np.eye(2))) / (m - 1 + c)
    student = (1.0 + 1.0 / m) * 8.0 / 6.0
    expected = [student * np.kron(row, np.eye(2)) @ sigma @ np.kron(row, np.eye(2)).T for row in phi]
    np.testing.assert_allclose(model.means_["still"][:, 1:], phi @ w.mean(axis=0), atol=1e-10)
    np.testing.assert_allclose(within_steps(model), expected, atol=1e-9)


def test_tremor_is_left_out_of_the_path_and_counts_as_uncertain() -> None:
    rng = np.random.default_rng(1)
    u = np.linspace(0.0, 1.0, 100)
    smooth = np.column_stack([u**2, np.sin(3.0 * u)])
    paths = smooth + 0.02 * rng.normal(size=(4, 100, 2))
    promp = ProMPTPGMM(manifold="R1 x R2", reg_covar=0.0, n_basis=8).fit(shown(paths))
    steps = TimeStepTPGMM(manifold="R1 x R2", reg_covar=0.0).fit(shown(paths))

    def off(model: TimeStepTPGMM) -> float:
        return float(np.sqrt(np.mean((model.means_["still"][:, 1:] - smooth) ** 2)))

    assert off(promp) < 0.5 * off(steps) and off(promp) < 0.005
    assert within_steps(promp)[:, 0, 0].min() > 0.02**2 * 0.8


@cache
def learned(count: int) -> ProMPTPGMM:
    model = ProMPTPGMM(manifold="R1 x R3 x S3").fit(reaching_demonstrations(count))
    model.metadata_ = {"duration_s": DURATION}
    return model


def test_three_demonstrations_of_a_hand_are_enough_to_find_the_object_elsewhere() -> None:
    movement, errors = TimeSteps(learned(3)), []
    for demonstration in reaching_demonstrations(20)[3:]:
        movement.situate(demonstration.frames)
        means, _, _ = movement.at(demonstration.times)
        errors.append(np.abs(POSE.log(means[-1], demonstration.data[-1, 1:])))
    assert np.median(errors, axis=0)[:3].max() < 0.01 and np.median(errors, axis=0)[3:].max() < 0.05


def test_one_demonstration_is_reproduced() -> None:
    one = reaching_demonstrations()[0]
    movement = TimeSteps(ProMPTPGMM(manifold="R1 x R3 x S3").fit([one]))
    movement.situate(one.frames)
    assert np.abs(POSE.log(movement.at(one.times)[0], one.data[:, 1:])).max() < 0.05


def test_a_frame_that_saw_nothing_at_a_time_has_no_say_there() -> None:
    hidden = [
        Demonstration(d.times, d.data, d.frames, {"goal": d.times > d.times[40]}) for d in planar_demonstrations()
    ]
    model = ProMPTPGMM(n_steps=20, n_basis=8, manifold="R1 x R2").fit(hidden)
    widths = np.trace(model.covariances_["goal"][:, 1:, 1:], axis1=1, axis2=2)
    assert widths[:8].min() > 10.0 * widths[12:].max()


@pytest.mark.parametrize("n_basis", [1, 101, 2.5, True])
def test_a_number_of_basis_functions_that_cannot_be_is_refused(n_basis: object) -> None:
    with pytest.raises(ValueError, match="n_basis is an integer from 2"):
        ProMPTPGMM(n_basis=n_basis).fit(planar_demonstrations())  # type: ignore[arg-type]
