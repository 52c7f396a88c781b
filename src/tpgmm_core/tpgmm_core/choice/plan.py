# SPDX-License-Identifier: Apache-2.0
"""What is tried, in which order: methods and frames, segments, components, then frames one by one, then priors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tpgmm_core.choice.search import LEADERS, Search
from tpgmm_core.choice.trial import Trial
from tpgmm_core.learning.time_warping import KEY as WARP_KEY
from tpgmm_core.retrieval.methods import ALL_METHODS, DEFAULT, KEY, METHODS
from tpgmm_core.retrieval.segment_frames import KEY as PRUNE_KEY

COMPONENTS = (3, 5, 7, 10, 14)
STRUCTURES = ("diag", "full")
MORE_STRUCTURES = ("tied", "mppca", "semi_tied")
PRIORS = (1e-5, 1e-4, 1e-3, 1e-2)
"""Tried as `reg_covar` that is added, and as prior."""
LOCALITIES = (0.3, 1.0, 3.0)
"""How much more demonstrations say whose situations are near, for methods that can tell."""
STRENGTHS = (0.0, 1.0, 3.0, 10.0, 30.0)
"""Of the prior of the covariances, in demonstrations."""
PRUNED = (0.2, 0.4)
"""Relevances below which a frame is left out of a segment of the movement."""
MORE_FRAMES = 2
"""Declared frames that the screen drops, up to which they are tried with every method all the same."""
START = 7
"""Components while methods and frames are compared."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Rounds of trials.

    Parameters
    ----------
    declared
        frames that the task file names
    kept
        frames that the screen keeps
    candidates
        frames that may be added one by one
    settings
        of the task file: what is not searched for stays as it says
    methods
        of retrieval
    """

    declared: tuple[str, ...]
    kept: tuple[str, ...]
    candidates: tuple[str, ...]
    settings: Mapping[str, Any]
    methods: tuple[str, ...] = tuple(METHODS)

    def rounds(self, search: Search) -> Iterator[Sequence[Trial]]:
        """See `tpgmm_core.choice.search.Rounds`."""
        yield self._first()
        yield [
            pruned
            for result in search.leaders[:LEADERS]
            for least in PRUNED
            if PRUNE_KEY in (pruned := result.trial.changed(**{PRUNE_KEY: least})).settings
        ]
        yield [
            result.trial.changed(n_components=K)
            for result in search.leaders[:LEADERS]
            if "n_components" in result.trial.settings
            for K in COMPONENTS
        ]
        yield [
            warped
            for result in search.leaders[:LEADERS]
            if WARP_KEY in (warped := result.trial.changed(**{WARP_KEY: True})).settings
        ]
        yield self._frames(search.leaders[0].trial)
        yield [
            *self._structures(search.leaders[0].trial),
            *(trial for result in search.leaders[:LEADERS] for trial in self._weights(result.trial)),
        ]
        best = search.leaders[0].trial
        yield [*self._frames(best), *self._components(best)]

    def _first(self) -> list[Trial]:
        """What the task file says, then every method; functions of time first, which are quick to try."""
        settings = {name: value for name, value in self.settings.items() if name != KEY}
        methods = sorted(self.methods, key=lambda name: ALL_METHODS[name].time_parametrized is None)
        default = DEFAULT if DEFAULT in methods else methods[0]
        given = Trial.of(str(self.settings.get(KEY, default)), self.declared, {"n_components": START, **settings})
        # With many frames that the screen drops, every model of all of them would be slow to learn, and poor
        sets = [self.kept, *([self.declared] if len(self.declared) <= len(self.kept) + MORE_FRAMES else [])]
        others = [
            Trial.of(method, frames, {**settings, "covariance": structure, "n_components": START})
            for frames in sets
            for method in methods
            for structure in STRUCTURES
        ]
        return [given, *others]

    def _frames(self, trial: Trial) -> list[Trial]:
        """One frame fewer, or one more."""
        fewer = [[name for name in trial.frames if name != one] for one in trial.frames]
        more = [[*trial.frames, name] for name in self.candidates if name not in trial.frames]
        return [trial.seen_from(frames) for frames in (*fewer, *more) if frames]

    def _structures(self, trial: Trial) -> list[Trial]:
        if "covariance" not in trial.settings:
            return []
        priors = [
            trial.changed(regularization=kind, reg_covar=strength) for kind in ("add", "prior") for strength in PRIORS
        ]
        return [*priors, *(trial.changed(covariance=structure) for structure in (*STRUCTURES, *MORE_STRUCTURES))]

    @staticmethod
    def _weights(trial: Trial) -> list[Trial]:
        """Other strengths of the prior, and localities: how far demonstrations are believed is theirs to tell."""
        recipe = trial.recipe
        present = recipe.method.estimator(**recipe.arguments).prior_strength
        strengths = [trial.changed(prior_strength=strength) for strength in STRENGTHS if strength != present]
        localities = [trial.changed(locality=locality) for locality in LOCALITIES]
        return [*strengths, *(other for other in localities if "locality" in other.settings)]

    def _components(self, trial: Trial) -> list[Trial]:
        if "n_components" not in trial.settings:
            return []
        K = int(trial.settings["n_components"])
        near = [k for k in (K - 2, K - 1, K + 1, K + 2) if k >= 1]
        return [trial.changed(n_components=k) for k in near]
