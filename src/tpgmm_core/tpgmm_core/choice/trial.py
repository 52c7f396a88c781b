# SPDX-License-Identifier: Apache-2.0
"""`Trial`: one way of learning a movement, and how well it reproduces demonstrations that it has not seen.

What is compared is what a robot would do: the path in the situation of each demonstration that was left out, by
position and orientation, over the whole movement and again where the hand is nearest to each object and at the end.
Likelihood is not compared: it is not the same for models of other frames, other methods or other encodings, and may be
high where the reproduction is poor.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.frame_screen import distances
from tpgmm_core.learning.time_warping import KEY as WARP_KEY
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.derived_frames import with_frames
from tpgmm_core.retrieval.exact import KEY as EXACT_KEY
from tpgmm_core.retrieval.methods import KEY, method_named
from tpgmm_core.retrieval.own_end import KEY as END_KEY
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.segment_frames import KEY as PRUNE_KEY

WORTH = 0.01
"""A frame has to make the error less by this share: one that does not matter may do so a little by chance."""
MAX_FOLDS = 8
"""Of more demonstrations, several are left out at once: so many models are learned for each trial at most."""
SAMPLES = 60
"""Samples of each demonstration that trials learn from, and the model that is chosen."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One way of learning a movement.

    Parameters
    ----------
    method
        of retrieval
    frames
        names, in the order of the model
    settings
        of encoding and estimator, as task files hold them, without the method
    """

    method: str
    frames: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, method: str, frames: Sequence[str], settings: Mapping[str, Any]) -> Trial:
        """Take of the settings those that the method has and takes notice of.

        Parameters
        ----------
        method
            of retrieval, by name
        frames
            names
        settings
            of the method, and others

        Returns
        -------
        Trial
            the trial
        """
        chosen = method_named(method)
        known = {item.name for item in fields(chosen.encoding)} | inspect.signature(chosen.estimator).parameters.keys()
        allowed = {
            EXACT_KEY: True,
            PRUNE_KEY: chosen.has_segments,
            END_KEY: chosen.may_own_end,
            WARP_KEY: chosen.may_warp_time,
            KEY: False,
        }
        used = (known | allowed.keys()) - {name for name, is_allowed in allowed.items() if not is_allowed}
        return cls(chosen.name, tuple(frames), {name: settings[name] for name in settings if name in used})

    def changed(self, **settings: Any) -> Trial:
        """The same with other settings."""
        return Trial.of(self.method, self.frames, {**self.settings, **settings})

    def seen_from(self, frames: Sequence[str]) -> Trial:
        """The same with other frames."""
        return Trial(self.method, tuple(frames), self.settings)

    @property
    def recipe(self) -> Recipe:
        """How its model is learned. Raises ValueError for settings that do not fit together."""
        return Recipe.of(self.settings, self.method)

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for trials that are the same, whatever the order of their frames and settings."""
        return self.method, frozenset(self.frames), tuple(sorted(self.settings.items()))


@dataclass(frozen=True, slots=True)
class HeldOutError:
    """How far the reproduction of one demonstration that was left out is from what was shown, at the same times.

    Parameters
    ----------
    position
        root mean square, m
    orientation
        mean, rad
    objects
        mean distance where the shown hand is nearest to each object, and at the end; a turn by 0.1 rad is a centimetre,
        m
    end
        of the position at the end, m
    cost
        what is compared: half the root mean square of the whole path, turns counted as above, half `objects`, m
    """

    position: float
    orientation: float
    objects: float
    end: float
    cost: float

    @classmethod
    def of(cls, path: Array, shown: Demonstration, objects: Sequence[str]) -> HeldOutError:
        """Errors of a path.

        Parameters
        ----------
        path
            shape (T, 7) or (T, 3)
        shown
            what it should have been
        objects
            frames whose origins count as objects

        Returns
        -------
        HeldOutError
            the errors
        """
        points = shown.data[:, 1:]
        off = distances(path, points)
        positions = np.linalg.norm(path[:, :3] - points[:, :3], axis=1)
        turns = np.zeros(1)
        if points.shape[1] == 7:
            turns = quaternion.angle_between(quaternion.normalize(path[:, 3:]), points[:, 3:])
        at = [nearest_sample(shown, name) for name in objects]
        near = float(np.mean([off[i] for i in (*at, len(off) - 1)]))
        return cls(
            position=float(np.sqrt(np.mean(positions**2))),
            orientation=float(np.mean(turns)),
            objects=near,
            end=float(positions[-1]),
            cost=0.5 * float(np.sqrt(np.mean(off**2))) + 0.5 * near,
        )


def nearest_sample(shown: Demonstration, name: str) -> int:
    """The sample at which the hand is nearest to a frame's origin."""
    away = np.linalg.norm(shown.data[:, 1:4] - shown.frames[name].b[..., 1:4], axis=1)
    return int(np.argmin(away))


@dataclass(frozen=True, slots=True)
class TrialResult:
    """What became of a trial.

    Parameters
    ----------
    trial
        what was tried
    errors
        of each demonstration, by its number; of some only where the trial was given up
    log_likelihood
        of the demonstrations left out, mean per sample; NaN where not known
    is_complete
        whether all demonstrations were reproduced
    refusals
        why demonstrations could not be reproduced, or no model learned; such a one counts as if the hand had stayed
        where it was
    """

    trial: Trial
    errors: Mapping[int, HeldOutError]
    log_likelihood: float = math.nan
    is_complete: bool = True
    refusals: tuple[str, ...] = ()

    @property
    def cost(self) -> float:
        """Mean cost over the demonstrations, m; infinite for a trial that was given up."""
        return self._mean("cost") if self.is_complete else math.inf

    @property
    def merit(self) -> float:
        """The cost, and WORTH of it for each frame: what trials are compared by, m; the less, the better."""
        return self.cost * price(self.trial)

    @property
    def standard_error(self) -> float:
        """Of the cost's mean over demonstrations, m."""
        costs = [error.cost for error in self.errors.values()]
        return float(np.std(costs, ddof=1) / math.sqrt(len(costs))) if len(costs) > 1 else math.nan

    def _mean(self, name: str) -> float:
        return float(np.mean([getattr(error, name) for error in self.errors.values()]))

    def mean(self) -> HeldOutError:
        """Mean errors over the demonstrations."""
        return HeldOutError(*(self._mean(item.name) for item in fields(HeldOutError)))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What trials are judged by.

    Parameters
    ----------
    demonstrations
        over [time, position] or [time, pose], with all frames that trials may name
    manifold
        space of their data
    objects
        frames whose origins count as objects
    """

    demonstrations: tuple[Demonstration, ...]
    manifold: Manifold
    objects: tuple[str, ...]

    @classmethod
    def of(
        cls,
        demonstrations: Sequence[Demonstration],
        manifold: str | Manifold,
        objects: Sequence[str],
        samples: int = SAMPLES,
    ) -> Problem:
        """Make one, with at most so many samples of each demonstration.

        Returns
        -------
        Problem
            the problem

        Raises
        ------
        ValueError
            for fewer than three demonstrations
        """
        if len(demonstrations) < 3:
            raise ValueError(
                f"a choice by held-out reproduction needs at least three demonstrations, got {len(demonstrations)}: "
                "record more, or say in the task file what to learn with"
            )
        space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold)
        return cls(tuple(thinned(shown, samples) for shown in demonstrations), space, tuple(objects))

    @property
    def folds(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the demonstrations that are left out together."""
        M = len(self.demonstrations)
        return tuple(tuple(range(g, M, min(M, MAX_FOLDS))) for g in range(min(M, MAX_FOLDS)))

    def judge(self, trial: Trial, give_up: Callable[[float], bool] = lambda cost: False) -> TrialResult:
        """Learn without each fold, and reproduce it.

        Parameters
        ----------
        trial
            what to learn with
        give_up
            called after each fold with the least that the trial's merit can become; True ends it

        Returns
        -------
        TrialResult
            merit, and the errors of each fold
        """
        M = len(self.demonstrations)
        errors: dict[int, HeldOutError] = {}
        scores: list[float] = []
        refusals: list[str] = []
        shown = [with_frames(demonstration, trial.frames) for demonstration in self.demonstrations]
        for fold in self.folds:
            training = [shown[i] for i in range(M) if i not in fold]
            try:
                recipe = trial.recipe
                model = recipe.learn(training, self.manifold)
            except (ValueError, np.linalg.LinAlgError) as error:
                return TrialResult(trial, errors, is_complete=False, refusals=(str(error),))
            for i in fold:
                whole = self.demonstrations[i]
                try:
                    path = reproduce(model, shown[i])
                    scores.append(model.score([recipe.encoding.encode(shown[i], self.manifold)]))
                except (ValueError, np.linalg.LinAlgError) as error:
                    refusals.append(f"demonstration {i}: {error}")
                    path = np.tile(whole.data[:1, 1:], (len(whole.times), 1))
                errors[i] = HeldOutError.of(path, whole, self.objects)
            if len(errors) < M and give_up(price(trial) * sum(error.cost for error in errors.values()) / M):
                return TrialResult(trial, errors, is_complete=False, refusals=tuple(refusals))
        return TrialResult(trial, errors, float(np.mean(scores)) if scores else math.nan, refusals=tuple(refusals))


def price(trial: Trial) -> float:
    """What a trial's cost is multiplied with, for its frames."""
    return 1.0 + WORTH * len(trial.frames)


def thinned(demonstration: Demonstration, n: int) -> Demonstration:
    """At most n samples of a demonstration, evenly by number, the last one too."""
    T = len(demonstration.times)
    return demonstration if T <= n else demonstration.at(np.linspace(0, T - 1, n).round().astype(np.intp))
