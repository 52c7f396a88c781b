# SPDX-License-Identifier: Apache-2.0
"""The estimators as scikit-learn knows them: its own checks, over all estimators of the package."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.utils import check_array, estimator_checks
from sklearn.utils.validation import check_is_fitted

from tpgmm_core import TPGMM
from tpgmm_core.learning.dirichlet import DirichletTPGMM
from tpgmm_core.learning.dp_means import DPMeans
from tpgmm_core.learning.ends import GoalTPGMM
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.incremental.online import OnlineTPGMM

ESTIMATORS: list[Any] = [TPGMM, DirichletTPGMM, TPHMM, TPHSMM, GoalTPGMM, OnlineTPGMM, DPMeans]

# Of the estimators as they are: these checks do not call fit
CHECKS: list[Callable[[str, Any], None]] = [
    estimator_checks.check_estimator_cloneable,
    estimator_checks.check_estimator_repr,
    estimator_checks.check_get_params_invariance,
    estimator_checks.check_set_params,
    estimator_checks.check_no_attributes_set_in_init,
    estimator_checks.check_parameters_default_constructible,
    estimator_checks.check_do_not_raise_errors_in_init_or_set_params,
    estimator_checks.check_valid_tag_types,
    estimator_checks.check_estimator_tags_renamed,
    estimator_checks.check_mixin_order,
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("kind", ESTIMATORS)
def test_arguments_are_parameters_as_scikit_learn_has_them(kind: Any, check: Callable[[str, Any], None]) -> None:
    check(kind.__name__, kind())


def of_arrays(kind: Any) -> Any:
    """The estimator with scikit-learn's fit(X): one frame that sees X as it is, by `fit_projected`. Nothing else is
    changed; what X may be is checked as every estimator of scikit-learn does.
    """

    def fit(self: Any, X: Any, y: Any = None) -> Any:
        X = check_array(X, dtype=float, ensure_min_samples=2, estimator=self)
        self.n_features_in_ = X.shape[1]
        return kind.fit_projected(self, {"frame": X})

    def tags(self: Any) -> Any:
        result = kind.__sklearn_tags__(self)
        result.input_tags.two_d_array = True
        return result

    body = {"fit": fit, "__init__": kind.__init__, "__sklearn_tags__": tags, "__module__": __name__}
    return type(kind.__name__ + "OfArrays", (kind,), body)


OF_ARRAYS = {kind.__name__ + "OfArrays": of_arrays(kind) for kind in ESTIMATORS}
globals().update(OF_ARRAYS)  # for pickles, which name classes

# The core does not depend on scikit-learn, and so does not inherit from its BaseEstimator
warnings.filterwarnings("ignore", "Estimator .* does not inherit from")

# Data of the checks are random, without time: k-means starts there. Few samples: two components, and regularised
SETTINGS: dict[str, Any] = {"n_components": 2, "init": "kmeans", "reg_covar": 1e-2}

NOT_MEANT = {
    "check_n_features_in_after_fitting": "score takes demonstrations, whose frames it checks against the model's",
    "check_fit_score_takes_y": "score takes demonstrations, and there is no y",
    "check_pipeline_consistency": "score takes demonstrations, not the arrays that a pipeline hands on",
}


def made(kind: Any) -> Any:
    names = kind._parameter_names()
    return kind(**{name: value for name, value in SETTINGS.items() if name in names})


@estimator_checks.parametrize_with_checks(
    [made(kind) for kind in OF_ARRAYS.values()],
    legacy=True,
    # DPMeans has no score
    expected_failed_checks=lambda estimator: {} if isinstance(estimator, DPMeans) else NOT_MEANT,
    xfail_strict=True,
)
def test_fitting_follows_the_rules_of_scikit_learn(estimator: Any, check: Any) -> None:
    check(estimator)


@pytest.mark.parametrize("kind", [kind for kind in ESTIMATORS if kind is not DPMeans])
def test_a_clone_has_the_arguments_and_nothing_that_was_learned(kind: Any) -> None:
    X = {"frame": np.random.default_rng(0).normal(size=(40, 2))}
    model = kind(n_components=2, init="kmeans", reg_covar=1e-3).fit_projected(X)
    check_is_fitted(model)
    copy = clone(model)
    assert type(copy) is kind and not hasattr(copy, "priors_") and not copy.__sklearn_is_fitted__()
    assert copy.get_params() == model.get_params()
    np.testing.assert_array_equal(copy.fit_projected(X).means_["frame"], model.means_["frame"])


def test_a_clone_starts_from_the_same_fitted_model() -> None:
    X = {"frame": np.random.default_rng(0).normal(size=(40, 2))}
    start = TPGMM(2, init="kmeans").fit_projected(X)
    model = clone(TPGMM(2, init=start))
    assert model.init is not start
    np.testing.assert_array_equal(model.init.means_["frame"], start.means_["frame"])
    assert repr(model) == "TPGMM(n_components=2, init=<TPGMM>)"
    expected = TPGMM(2, init=start).fit_projected(X)
    np.testing.assert_array_equal(model.fit_projected(X).means_["frame"], expected.means_["frame"])
    labels = np.arange(40) % 2
    assert clone(TPGMM(2, init=labels)).init is not labels
    assert repr(TPGMM(2, init=labels)) == "TPGMM(n_components=2, init=<array of shape (40,)>)"


def test_an_unknown_parameter_changes_none() -> None:
    model = TPGMM(2)
    with pytest.raises(ValueError, match="no parameter 'components'"):
        model.set_params(n_components=5, components=3)
    assert model.n_components == 2
    assert pickle.loads(pickle.dumps(model)).get_params() == model.get_params()
