# SPDX-License-Identifier: Apache-2.0
"""`TPGMM`: the task-parameterized Gaussian mixture model, learned by EM over frames (Section 3)."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core import initialization, model_file
from tpgmm_core.adaptation import Adapter
from tpgmm_core.demonstration import Demonstration
from tpgmm_core.estimation import Estimate, Parameters, Progress, Samples, expectation_maximisation
from tpgmm_core.frame import Frame
from tpgmm_core.manifold import Manifold
from tpgmm_core.mixture import GaussianMixture
from tpgmm_core.quaternion import Array


class TPGMM:
    """Gaussian mixture that is observed from several frames at once.

    Parameters (stored unchanged; checked by `fit`)
    ----------
    n_components : K
    init : "time" (bins of equal width between the first and the last time), "bins" (every demonstration cut
        into K parts of equal counts), "kmeans" (k-means++ on all frames' views side by side), or a fitted
        TPGMM
    reg_covar : added to the diagonal of the covariances, in squared units of the data
    tol : EM stops when an iteration gains less, in log-likelihood per sample
    max_iter : most iterations of EM
    random_state : seed or generator for "kmeans"
    manifold : space of the data, e.g. "R1 x R3 x S3"; "euclidean" is R^D for any D, also different per frame
    regularization : "add", or "prior", whose objective never falls: see `expectation_maximisation`

    Attributes after fitting
    ------------------------
    priors_ : shape (K,); means_ : name → (K, D_j); covariances_ : name → (K, n_j, n_j), tangent dimensions
    log_likelihood_, log_likelihoods_ : per sample, the last and their course; objectives_ : what EM maximises
    n_iter_, converged_, frame_names_, manifold_ (the space of the data; on R^D with frames that were
    projected elsewhere, the largest D_j), dimensions_ (names, or None), metadata_ (free-form texts and
    numbers)
    """

    priors_: Array
    means_: dict[str, Array]
    covariances_: dict[str, Array]
    log_likelihood_: float
    log_likelihoods_: Array
    objectives_: Array
    n_iter_: int
    converged_: bool
    frame_names_: tuple[str, ...]
    manifold_: Manifold
    dimensions_: tuple[str, ...] | None
    metadata_: dict[str, str | float]

    def __init__(
        self,
        n_components: int = 3,
        init: str | TPGMM = "time",
        reg_covar: float = 1e-4,
        tol: float = 1e-5,
        max_iter: int = 100,
        random_state: int | np.random.Generator | None = 0,
        manifold: str | Manifold = "euclidean",
        regularization: str = "add",
    ) -> None:
        self.n_components = n_components
        self.init = init
        self.reg_covar = reg_covar
        self.tol = tol
        self.max_iter = max_iter
        self.random_state = random_state
        self.manifold = manifold
        self.regularization = regularization

    @classmethod
    def _parameter_names(cls) -> list[str]:
        return list(inspect.signature(cls).parameters)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Constructor arguments by name."""
        return {name: getattr(self, name) for name in self._parameter_names()}

    def set_params(self, **params: Any) -> Self:
        """Set constructor arguments by name. Raises ValueError for an unknown one."""
        for name, value in params.items():
            if name not in self._parameter_names():
                raise ValueError(f"TPGMM has no parameter {name!r}; it has {', '.join(self._parameter_names())}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        defaults = inspect.signature(type(self)).parameters
        changed = {k: v for k, v in self.get_params().items() if v is not defaults[k].default}
        shown = [f"{k}=<fitted TPGMM>" if isinstance(v, TPGMM) else f"{k}={v!r}" for k, v in changed.items()]
        return f"TPGMM({', '.join(shown)})"

    def fit(self, demonstrations: Sequence[Demonstration], progress: Progress | None = None) -> Self:
        """Learn from demonstrations, projected into their frames by Eq. (4).

        progress is called with (iteration, log-likelihood per sample). Raises ValueError for demonstrations
        that do not agree in dimensions or frames, and for data that the constructor arguments do not fit.
        """
        demonstrations = list(demonstrations)
        if not demonstrations:
            raise ValueError("fit needs at least one demonstration")
        names = list(demonstrations[0].frames)
        D = demonstrations[0].data.shape[1]
        for i, demonstration in enumerate(demonstrations):
            if set(demonstration.frames) != set(names):
                raise ValueError(
                    f"demonstration {i} has the frames {sorted(demonstration.frames)}, 0 has {sorted(names)}"
                )
            if demonstration.data.shape[1] != D:
                raise ValueError(f"demonstration {i} has {demonstration.data.shape[1]} dimensions, 0 has {D}")
        views = [demonstration.projected() for demonstration in demonstrations]
        for name in names:
            if len({view[name].shape[1] for view in views}) > 1:
                raise ValueError(f"frame {name!r} has views of different dimensions in different demonstrations")
        X = {name: np.concatenate([view[name] for view in views]) for name in names}
        seen = np.stack([np.concatenate([d.is_visible(name) for d in demonstrations]) for name in names])
        times = np.concatenate([d.times for d in demonstrations])
        return self._fit(X, seen, times, [len(d.times) for d in demonstrations], D, progress)

    def fit_projected(
        self,
        X: Mapping[str, ArrayLike],
        visible: Mapping[str, ArrayLike] | None = None,
        progress: Progress | None = None,
    ) -> Self:
        """Learn from data that was already observed from each frame.

        X : name → shape (N, D_j); visible : name → mask (N,), always seen where not named. For init="time"
        the time is the first dimension of the first frame; for "bins" all samples are one demonstration.
        Raises ValueError for shapes that do not fit.
        """
        if not X:
            raise ValueError("fit_projected needs the data of at least one frame")
        arrays = {name: np.array(x, dtype=float) for name, x in X.items()}
        first = next(iter(arrays.values()))
        for name, x in arrays.items():
            if x.ndim != 2 or len(x) != len(first) or x.size == 0:
                raise ValueError(f"data has shape (N, D_j) with the same N > 0 in all frames, {name!r} has {x.shape}")
        masks = {name: np.asarray(mask) for name, mask in (visible or {}).items()}
        for name, mask in masks.items():
            if name not in arrays or mask.shape != (len(first),) or mask.dtype != np.bool_:
                raise ValueError(
                    f"visible is frame name → bool mask ({len(first)},), got {name!r}: {mask.dtype} {mask.shape}"
                )
        seen = np.stack([masks.get(name, np.ones(len(first), dtype=bool)) for name in arrays])
        D = max(x.shape[1] for x in arrays.values())
        return self._fit(arrays, seen, first[:, 0], [len(first)], D, progress)

    def _fit(
        self,
        X: dict[str, Array],
        seen: NDArray[np.bool_],
        times: Array,
        lengths: Sequence[int],
        D: int,
        progress: Progress | None,
    ) -> Self:
        self._check_parameters()
        manifold = self.manifold if isinstance(self.manifold, Manifold) else Manifold.parse(self.manifold, D)
        manifolds: dict[str, Manifold] = {}
        for j, (name, x) in enumerate(X.items()):
            if not seen[j].any():
                raise ValueError(f"frame {name!r} was never seen: leave it out")
            if not np.all(np.isfinite(x[seen[j]])):
                raise ValueError(f"the data of frame {name!r} must be finite where it is visible")
            x[~seen[j]] = x[seen[j]][0]  # any point of the space: its weight is zero
            manifolds[name] = _view_manifold(manifold, x.shape[1])
            if x.shape[1] != manifolds[name].dim:
                raise ValueError(f"on {manifold} every frame has {manifold.dim} dimensions, {name!r} has {x.shape[1]}")
        if len(times) < self.n_components:
            raise ValueError(f"{self.n_components} components need at least as many samples, got {len(times)}")
        samples = Samples(manifolds, X, seen, times, lengths)
        estimate = expectation_maximisation(
            samples,
            self._start(samples),
            reg_covar=self.reg_covar,
            regularization=self.regularization,
            tol=self.tol,
            max_iter=self.max_iter,
            progress=progress,
        )
        self._learned(estimate, manifold)
        return self

    def _learned(self, estimate: Estimate, manifold: Manifold) -> None:
        self.priors_ = estimate.parameters.priors
        self.means_ = dict(estimate.parameters.means)
        self.covariances_ = dict(estimate.parameters.covariances)
        self.log_likelihoods_ = estimate.log_likelihoods
        self.log_likelihood_ = float(estimate.log_likelihoods[-1])
        self.objectives_ = estimate.objectives
        self.n_iter_ = len(estimate.log_likelihoods)
        self.converged_ = estimate.converged
        self.frame_names_ = tuple(self.means_)
        self.manifold_ = manifold
        self.dimensions_ = None
        self.metadata_ = {}

    @property
    def frame_manifolds_(self) -> dict[str, Manifold]:
        """Name → space of the frame's view."""
        return {name: _view_manifold(self.manifold_, mean.shape[1]) for name, mean in self.means_.items()}

    def _check_parameters(self) -> None:
        for name, lowest in (("n_components", 1), ("max_iter", 1)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < lowest:
                raise ValueError(f"{name} is an integer from {lowest}, got {value!r}")
        for name in ("reg_covar", "tol"):
            value = getattr(self, name)
            if not isinstance(value, int | float | np.number) or not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} is a finite number from 0, got {value!r}")
        if self.regularization not in ("add", "prior"):
            raise ValueError(f'regularization is "add" or "prior", got {self.regularization!r}')
        if not isinstance(self.init, TPGMM) and self.init not in ("time", "bins", "kmeans"):
            raise ValueError(f'init is "time", "bins", "kmeans" or a fitted TPGMM, got {self.init!r}')

    def _start(self, samples: Samples) -> Parameters:
        if isinstance(self.init, TPGMM):
            return self._start_from(self.init, samples)
        K = self.n_components
        if self.init == "time":
            labels = initialization.time_bins(samples.times, K)
        elif self.init == "bins":
            labels = initialization.equal_bins(samples.lengths, K)
        else:
            views = list(samples.X.values())
            points = initialization.joint_points(list(samples.manifolds.values()), views, samples.seen)
            labels = initialization.kmeans(points, K, self.random_state)
        counts = np.bincount(labels[labels >= 0], minlength=K)
        if counts.min() == 0:
            raise ValueError(f"the start leaves component {np.argmin(counts)} without samples: take fewer components")
        means, covariances = {}, {}
        for (name, x), mask in zip(samples.X.items(), samples.seen, strict=True):
            means[name], covariances[name] = initialization.moments(
                samples.manifolds[name], x, mask, labels, K, self.reg_covar
            )
        return Parameters(counts / counts.sum(), means, covariances)

    def _start_from(self, other: TPGMM, samples: Samples) -> Parameters:
        other._check_fitted()
        shapes = {name: (self.n_components, x.shape[1]) for name, x in samples.X.items()}
        others = {name: mean.shape for name, mean in other.means_.items()}
        if shapes != others:
            raise ValueError(f"the model given as init has means of shapes {others}, the data asks for {shapes}")
        return Parameters(other.priors_, other.means_, other.covariances_)

    def _check_fitted(self) -> None:
        if not hasattr(self, "priors_"):
            raise ValueError("this TPGMM is not fitted yet: call fit or load first")

    def adapt(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> GaussianMixture:
        """The mixture in a new situation, by Eqs. (5) and (6): see `Adapter`, which a loop holds on to."""
        return Adapter(self).adapt(frames, state, weights)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a model file: see `model_file`."""
        self._check_fitted()
        settings = {k: v for k, v in self.get_params().items() if isinstance(v, str | int | float)}
        settings["manifold"] = str(self.manifold)
        contents = model_file.ModelContents(
            manifold=self.manifold_,
            priors=self.priors_,
            means=self.means_,
            covariances=self.covariances_,
            log_likelihoods=self.log_likelihoods_,
            objectives=self.objectives_,
            converged=self.converged_,
            settings=settings,
            dimensions=self.dimensions_,
            metadata=self.metadata_,
        )
        model_file.write(path, contents)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a model file. Raises ModelFileError when it is damaged or no model file."""
        contents = model_file.read(path)
        known = {k: v for k, v in contents.settings.items() if k in cls._parameter_names()}
        parameters = Parameters(contents.priors, contents.means, contents.covariances)
        model = cls(**known)  # type: ignore[arg-type]
        model._learned(
            Estimate(parameters, contents.log_likelihoods, contents.objectives, contents.converged),
            contents.manifold,
        )
        model.dimensions_ = contents.dimensions
        model.metadata_ = dict(contents.metadata)
        return model


def _view_manifold(manifold: Manifold, D_j: int) -> Manifold:
    """Space of what a frame sees: R^D_j on Euclidean data, else that of the data."""
    return Manifold.euclidean(D_j) if manifold.is_euclidean else manifold
