# SPDX-License-Identifier: Apache-2.0
"""`Recipe`: how a model is learned from demonstrations, so that a retrieval method can reproduce the movement."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np

from tpgmm_core.common.settings import configured
from tpgmm_core.common.text import listed
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.time_warping import KEY as WARP_KEY
from tpgmm_core.learning.time_warping import on_common_time
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.encodings import Encoding
from tpgmm_core.retrieval.exact import KEY as EXACT_KEY
from tpgmm_core.retrieval.exact import parsed
from tpgmm_core.retrieval.methods import DEFAULT, KEY, RetrievalMethod, method_named
from tpgmm_core.retrieval.own_end import KEY as END_KEY
from tpgmm_core.retrieval.own_end import keep_end
from tpgmm_core.retrieval.segment_frames import KEY as PRUNE_KEY
from tpgmm_core.retrieval.segment_frames import prune

PRIOR_STRENGTH = 3.0
"""Weight, in demonstrations, of the prior of the covariances where settings name none: half of one for each dimension
of a pose. On recordings of real robots, leave-one-out, errors fall with it, and hardly change from there up to 10."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """A retrieval method, what it encodes, and how the model is fitted to that.

    Parameters
    ----------
    method
        what the model is for
    encoding
        of the demonstrations
    arguments
        of the method's estimator, without the manifold
    exact
        what the movement meets exactly, as a text (`tpgmm_core.retrieval.exact.parsed`)
    prune
        relevance below which a frame is left out of a segment (`tpgmm_core.retrieval.segment_frames`); 0: none is
    own_end
        whether the end of the movement is a Gaussian of its own (`tpgmm_core.retrieval.own_end`)
    time_warping
        whether demonstrations get a common time first (`tpgmm_core.learning.time_warping`)
    """

    method: RetrievalMethod
    encoding: Encoding
    arguments: Mapping[str, Any] = field(default_factory=dict)
    exact: str | None = None
    prune: float = 0.0
    own_end: bool = False
    time_warping: bool = False

    @classmethod
    def of(cls, settings: Mapping[str, Any], method: str | None = None) -> Self:
        """Make a recipe from settings by name.

        They are `retrieval`, `exact`, `prune`, `own_end`, `time_warping`, those of the encoding and of the estimator.
        Settings of `TPGMM` that the method's estimator does not have are left out, `prune` where its models have no
        segments, `own_end` where the movement has such an end anyway, and `time_warping` where a movement repeats.
        Where they name no `prior_strength` and the estimator has none of its own, it is PRIOR_STRENGTH.

        Parameters
        ----------
        settings
            as task files hold them
        method
            in place of `retrieval`

        Returns
        -------
        Self
            the recipe

        Raises
        ------
        ValueError
            for a method that is not known, and a setting that neither encoding nor estimator have
        """
        rest = dict(settings)
        exact = rest.pop(EXACT_KEY, None)
        least = float(rest.pop(PRUNE_KEY, 0.0))
        if not 0.0 <= least <= 1.0:
            raise ValueError(f"{PRUNE_KEY} is a relevance from 0 to 1, got {least}")
        own_end, warping = (_truth(key, rest.pop(key, False)) for key in (END_KEY, WARP_KEY))
        named = rest.pop(KEY, DEFAULT)
        chosen = method_named(named if method is None else method)
        options = {item.name for item in fields(chosen.encoding)}
        arguments = [name for name in inspect.signature(chosen.estimator).parameters if name != "manifold"]
        # The settings of a task serve all methods, so that another one can be tried by its name alone
        elsewhere = inspect.signature(TPGMM).parameters.keys() - {"manifold", *arguments}
        rest = {name: value for name, value in rest.items() if name not in elsewhere}
        unknown = [name for name in rest if name not in options and name not in arguments]
        if unknown:
            known = ", ".join([*arguments, *sorted(options)])
            raise ValueError(f"unknown settings {listed(unknown)} of {chosen.name}; it has {known}")
        encoding = configured(
            chosen.encoding, {**chosen.options, **{name: rest.pop(name) for name in options if name in rest}}
        )
        if encoding.init is not None and "init" in arguments:
            rest.setdefault("init", encoding.init)
        if "prior_strength" in arguments and not chosen.estimator().prior_strength:
            rest.setdefault("prior_strength", PRIOR_STRENGTH)
        if exact is not None:
            parsed(exact)
        return cls(
            chosen,
            encoding,
            rest,
            exact,
            least if chosen.has_segments else 0.0,
            own_end and chosen.may_own_end,
            warping and chosen.may_warp_time,
        )

    @property
    def max_iter(self) -> int:
        """Largest number of iterations of EM; 1 for what is learned at once."""
        return int(self.method.estimator(**self.arguments).get_params().get("max_iter", 1))

    def learn(
        self,
        demonstrations: Sequence[Demonstration],
        manifold: str | Manifold,
        dimensions: Sequence[str] | None = None,
        progress: EmProgress | None = None,
    ) -> LearnedMixture:
        """A model of demonstrations over [time, data], whose metadata say what it is for.

        Parameters
        ----------
        demonstrations
            one or more, with the same frames
        manifold
            space of the demonstrations' data, time included
        dimensions
            names of its ambient numbers
        progress
            see `TPGMM.fit`

        Returns
        -------
        LearnedMixture
            a fitted model

        Raises
        ------
        ValueError
            for demonstrations that cannot be encoded or learned from
        """
        space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold)
        if self.time_warping:
            demonstrations = on_common_time(demonstrations, space)
        encoded = _Encoded([demonstrations], self.encoding, space)
        model = self._model(space)
        (shown,) = encoded
        model.fit(shown, progress)
        self._finished(model, encoded, dimensions)
        if self.prune:
            prune(model, demonstrations, shown, space, self.prune)
        if self.own_end:
            keep_end(model, demonstrations, space)
        if self.time_warping:
            model.metadata_[WARP_KEY] = 1.0
        return model

    def check_parts(self) -> None:
        """Check that `learn_parts` can learn in this way.

        Raises
        ------
        ValueError
            for a method, and for settings, that need all demonstrations at once
        """
        if self.method.estimator is not TPGMM:
            raise ValueError(
                f"{self.method.name} learns a {self.method.estimator.__name__}, which needs all demonstrations at "
                "once; Gaussian mixtures over time can be learned in parts"
            )
        if self.prune:
            raise ValueError(f"{PRUNE_KEY} compares all demonstrations at once")
        if self.own_end:
            raise ValueError(f"{END_KEY} takes the ends of all demonstrations at once")
        if self.time_warping:
            raise ValueError(f"{WARP_KEY} compares all demonstrations at once")
        TPGMM(**self.arguments).check_parts()

    def learn_parts(
        self,
        parts: Iterable[Sequence[Demonstration]],
        manifold: str | Manifold,
        dimensions: Sequence[str] | None = None,
        progress: EmProgress | None = None,
        jobs: int = 1,
    ) -> LearnedMixture:
        """What `learn` makes of all parts together, but for the last digits; one part is in the memory at a time.

        Parameters
        ----------
        parts
            see `TPGMM.fit_parts`
        manifold, dimensions, progress
            see `learn`
        jobs
            processes that share the parts, see `TPGMM.fit_parts`

        Returns
        -------
        LearnedMixture
            a fitted model

        Raises
        ------
        ValueError
            as `learn`, and as `check_parts`
        """
        self.check_parts()
        space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold)
        encoded = _Encoded(parts, self.encoding, space)
        model = self._model(space)
        assert isinstance(model, TPGMM)  # by `check_parts`
        model.fit_parts(encoded, progress, jobs)
        return self._finished(model, encoded, dimensions)

    def _model(self, space: Manifold) -> LearnedMixture:
        return self.method.estimator(**self.arguments, manifold=self.encoding.manifold(space))

    def _finished(self, model: LearnedMixture, encoded: _Encoded, dimensions: Sequence[str] | None) -> LearnedMixture:
        self.encoding.finish(model)
        if dimensions is not None:
            model.dimensions_ = self.encoding.dimensions(dimensions, encoded.space)
        model.metadata_ = {
            KEY: self.method.name,
            **self.encoding.metadata(),
            "duration_s": float(np.mean(encoded.durations)),
        }
        if self.exact is not None:
            model.metadata_[EXACT_KEY] = self.exact
            self.method.course(model)  # raises where it cannot be met
        return model


class _Encoded:
    """Parts of demonstrations over [time, data], encoded each time that they are gone through.

    Attributes
    ----------
    space
        of their data
    durations
        of the demonstrations that were gone through last, s
    """

    def __init__(self, parts: Iterable[Sequence[Demonstration]], encoding: Encoding, space: Manifold) -> None:
        self._parts, self._encoding, self.space = parts, encoding, space
        self.durations: list[float] = []

    def __iter__(self) -> Iterator[list[Demonstration]]:
        self.durations = []
        for part in self._parts:
            yield [self._encoded(demonstration) for demonstration in part]

    def _encoded(self, demonstration: Demonstration) -> Demonstration:
        number = len(self.durations)
        self.durations.append(float(demonstration.times[-1] - demonstration.times[0]))
        try:
            return self._encoding.encode(demonstration, self.space)
        except ValueError as error:
            raise ValueError(f"demonstration {number}: {error}") from error


def _truth(name: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{name} is true or false, got {value!r}")
    return value
