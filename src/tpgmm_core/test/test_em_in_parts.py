# SPDX-License-Identifier: Apache-2.0
"""EM over parts of the demonstrations comes to what EM of all of them comes to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.geometry import quaternion


def demonstrations(on_poses: bool, count: int = 7) -> list[Demonstration]:
    """Movements between two frames; one was not seen for a while, and not at all in the third one."""
    rng = np.random.default_rng(3)
    found = []
    for i in range(count):
        T = 40 + 3 * i
        times = np.linspace(0.0, 2.0 + 0.01 * i, T)
        s = (times / times[-1])[:, None]
        place, goal = rng.normal(0.0, 0.3, 3), rng.normal(0.0, 0.3, 3)
        data = np.hstack([times[:, None], place + s * (goal - place) + rng.normal(0.0, 0.01, (T, 3))])
        frames = {
            name: Frame.from_pose(at, quaternion.exp(rng.normal(0.0, 0.5, 3))).with_time()
            for name, at in (("object", place), ("target", goal))
        }
        if on_poses:
            turns = quaternion.exp(s * rng.normal(0.0, 0.4, 3) + rng.normal(0.0, 0.05, (T, 3)))
            data = np.hstack([data, turns])
        else:
            frames = {name: Frame(frame.A[:4, :4], frame.b[:4]) for name, frame in frames.items()}
        seen = np.ones(T, bool)
        seen[: 10 if i == 1 else T if i == 2 else 0] = False
        found.append(Demonstration(times, data, frames, {"target": seen}))
    return found


class Reread:
    """Parts that are made anew each time, as from bags; how often is counted."""

    def __init__(self, shown: Sequence[Demonstration], size: int) -> None:
        self.shown, self.size, self.passes = shown, size, 0

    def __iter__(self) -> Iterator[Sequence[Demonstration]]:
        self.passes += 1
        for first in range(0, len(self.shown), self.size):
            part = self.shown[first : first + self.size]
            yield [Demonstration(d.times, d.data, dict(reversed(list(d.frames.items()))), d.visible) for d in part]


@pytest.mark.parametrize("init", ["time", "bins", "model"])
@pytest.mark.parametrize("regularization", ["add", "prior"])
@pytest.mark.parametrize("manifold", ["euclidean", "R1 x R3 x S3"])
@pytest.mark.parametrize("strength", [0.0, 3.0])
def test_parts_come_to_the_same_as_all_at_once(strength: float, manifold: str, regularization: str, init: str) -> None:
    shown = demonstrations(manifold != "euclidean")
    begun = TPGMM(3, manifold=manifold, max_iter=2).fit(shown) if init == "model" else init
    settings: dict[str, Any] = {"init": begun, "manifold": manifold, "regularization": regularization, "max_iter": 30}
    settings["prior_strength"] = strength
    whole, parted = TPGMM(3, **settings).fit(shown), TPGMM(3, **settings).fit_parts(Reread(shown, 1))
    assert whole.n_iter_ == parted.n_iter_ > 5
    np.testing.assert_allclose(parted.log_likelihoods_, whole.log_likelihoods_, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(parted.priors_, whole.priors_, atol=1e-9)
    for name in ("object", "target"):
        signs = np.sign(np.sum(whole.means_[name][:, -4:] * parted.means_[name][:, -4:], axis=1))[:, None]
        means = parted.means_[name].copy()
        if manifold != "euclidean":
            means[:, -4:] *= signs
        np.testing.assert_allclose(means, whole.means_[name], atol=1e-9)
        np.testing.assert_allclose(parted.covariances_[name], whole.covariances_[name], atol=1e-9)


def test_processes_that_share_the_parts_find_the_same_bit_by_bit() -> None:
    shown = demonstrations(True)
    settings: dict[str, Any] = {"manifold": "R1 x R3 x S3", "prior_strength": 3.0, "max_iter": 5}
    one, two = (TPGMM(3, **settings).fit_parts(Reread(shown, 2), jobs=jobs) for jobs in (1, 2))
    assert np.array_equal(one.log_likelihoods_, two.log_likelihoods_)
    for name in ("object", "target"):
        assert np.array_equal(one.means_[name], two.means_[name])
        assert np.array_equal(one.covariances_[name], two.covariances_[name])


def test_the_size_of_the_parts_does_not_matter() -> None:
    shown = demonstrations(False)
    one, several = (TPGMM(3).fit_parts(Reread(shown, size)) for size in (7, 2))
    np.testing.assert_allclose(one.log_likelihoods_, several.log_likelihoods_, atol=1e-11)


def test_what_cannot_be_learned_in_parts_is_said() -> None:
    shown = demonstrations(False)
    with pytest.raises(ValueError, match="can be read only once"):
        TPGMM(3).fit_parts(iter([shown]))
    refused: list[dict[str, Any]] = [{"covariance": "diag"}, {"n_init": 2}, {"init": "kmeans"}]
    for settings in refused:
        with pytest.raises(ValueError, match="needs all samples at once"):
            TPGMM(3, **settings).fit_parts([shown])
    with pytest.raises(ValueError, match="at least one part"):
        TPGMM(3).fit_parts([])
    unseen = [Demonstration(d.times, d.data, d.frames, {"target": np.zeros(len(d.times), bool)}) for d in shown]
    with pytest.raises(ValueError, match="'target' was never seen"):
        TPGMM(3).fit_parts([unseen])
    with pytest.raises(ValueError, match="part 1 has frames of dimensions"):
        TPGMM(3).fit_parts([shown, [Demonstration(d.times, d.data, {"object": d.frames["object"]}) for d in shown]])
    once = Demonstration(np.zeros(1), np.zeros((1, 4)), {"object": Frame(np.eye(4), np.zeros(4))})
    with pytest.raises(ValueError, match="component 1 has no samples"):
        TPGMM(3, init="bins").fit_parts([[once] * 3])
