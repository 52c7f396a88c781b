# SPDX-License-Identifier: Apache-2.0
"""The numbers of docs/reference/results.md that others have given, to all digits given."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from tpgmm_core import TPGMM

DATA02 = Path(__file__).resolve().parents[2] / "shared" / "data" / "pbdlib" / "Data02.mat"


@pytest.mark.skipif(not DATA02.is_file(), reason="pbdlib's data are not beside the repository")
def test_data02_of_pbdlib() -> None:
    """Frames are scaled, and one is a reflection; the data (3, 2, 800) are observed from the frames already."""
    data = loadmat(DATA02)["Data"]
    views = {"first": data[:, 0].T, "second": data[:, 1].T}
    model = TPGMM(n_components=3, init="time", reg_covar=1e-4, tol=1e-5).fit_projected(views)
    assert model.converged_ and model.n_iter_ == 8
    assert model.log_likelihoods_[0] == pytest.approx(-2.704023, abs=5e-7)
    assert model.log_likelihood_ == pytest.approx(-2.471765, abs=5e-7)
    np.testing.assert_allclose(model.priors_, [0.40023, 0.25428, 0.34549], rtol=0.0, atol=5e-6)
    means = [[0.424341, -0.024678, 0.551346], [1.035234, 0.771874, 2.241621], [1.655415, 2.380758, 3.156574]]
    np.testing.assert_allclose(model.means_["first"], means, rtol=0.0, atol=5e-7)
