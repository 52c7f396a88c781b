# SPDX-License-Identifier: Apache-2.0
"""From demonstrations to a model, with frames, method and settings chosen by themselves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tpgmm_core.choice.candidates import frame_candidates, in_order_of_preference
from tpgmm_core.choice.plan import Plan
from tpgmm_core.choice.search import Search, TrialProgress, run_search
from tpgmm_core.choice.trial import SAMPLES, Problem, TrialResult, thinned
from tpgmm_core.choice.turns import one_turn, phases_of
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.cycles import TURN
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.frame_screen import METRES_PER_RADIAN, FrameScreen, screen_frames
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.derived_frames import BASE, HAND, DerivedFrames, with_frames
from tpgmm_core.retrieval.methods import METHODS, PERIODIC

POSITIONS = "R1 x R3"
STILL = 0.02
"""A frame that moves by less, m (a turn by 0.2 rad counts as that), has hardly moved: its influence cannot be known."""
MORE = 8
"""Frames that are tried as one more, at most."""
MISFIT = 3.0
"""A demonstration does not fit where its error is so many times that of the median one."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen, and why.

    Parameters
    ----------
    search
        what was tried
    screen
        what each frame says of the movement
    derived
        what the frames that are not observed are made of
    declared
        frames of the task
    still
        observed frames that hardly moved between the demonstrations or within them
    cycles
        of demonstrations that repeat, at most, the part of the last one too; 1 where they do not
    """

    search: Search
    screen: FrameScreen
    derived: DerivedFrames
    declared: tuple[str, ...]
    still: tuple[str, ...]
    cycles: int = 1

    @property
    def best(self) -> TrialResult:
        """What was chosen."""
        return self.search.best

    @property
    def given(self) -> TrialResult:
        """What the task file says."""
        return self.search.results[0]

    @property
    def misfits(self) -> tuple[int, ...]:
        """Numbers of the demonstrations that the others do not explain: wrong ones, or situations unlike all others."""
        costs = {i: error.cost for i, error in self.best.errors.items()}
        limit = MISFIT * float(np.median(list(costs.values())))
        return tuple(sorted(i for i, cost in costs.items() if cost > limit))

    def relevance(self, parts: int = 10) -> dict[str, list[float]]:
        """What each frame that was chosen says of where the hand is, in each part of the time or cycle; sums to 1."""
        return {name: shares.tolist() for name, shares in self.screen.relevance(self.best.trial.frames, parts).items()}

    def learn(
        self,
        demonstrations: Sequence[Demonstration],
        manifold: str | Manifold,
        dimensions: Sequence[str] | None = None,
        progress: EmProgress | None = None,
    ) -> LearnedMixture:
        """A model as it was chosen, which says in its metadata what its frames are made of.

        It is learned from as many samples of each demonstration as those were that trials were judged by: the window of
        derivatives and the weight of priors are in samples.

        Returns
        -------
        LearnedMixture
            a fitted model
        """
        trial = self.best.trial
        derived = self.derived.only(trial.frames)
        missing = [name for name in derived.sources if name not in demonstrations[0].frames]
        extended = [derived.only(missing).extended(item) for item in demonstrations]
        shown = [thinned(with_frames(item, trial.frames), SAMPLES * self.cycles) for item in extended]
        model = trial.recipe.learn(shown, manifold, dimensions, progress)
        model.metadata_ |= derived.metadata()
        return model

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        shares = self.screen.shares()
        return {
            "ended": self.search.ended,
            "best": _plain(self.best),
            "task_file": _plain(self.given),
            "frames": {
                name: {
                    "source": str(self.derived.sources.get(name, name)),
                    "screen_share": shares.get(name, 0.0),
                    "is_chosen": name in self.best.trial.frames,
                }
                for name in self.screen.names
            },
            "relevance_by_tenth": self.relevance(),
            "hardly_moved": list(self.still),
            "errors": {str(i): asdict(error) for i, error in sorted(self.best.errors.items())},
            "misfits": list(self.misfits),
            "trials": [_plain(result) for result in self.search.results],
        }


def _plain(result: TrialResult) -> dict[str, Any]:
    trial = result.trial
    values: dict[str, Any] = {"method": trial.method, "frames": list(trial.frames), "settings": dict(trial.settings)}
    if result.is_complete:
        values |= {"error": asdict(result.mean()), "standard_error": result.standard_error, "merit": result.merit}
        if np.isfinite(result.log_likelihood):
            values["log_likelihood"] = result.log_likelihood
    return values | {"is_complete": result.is_complete, "refusals": list(result.refusals)}


def choose(
    demonstrations: Sequence[Demonstration],
    manifold: str | Manifold,
    settings: Mapping[str, Any] | None = None,
    declared: DerivedFrames | None = None,
    *,
    methods: Sequence[str] | None = None,
    trials: int | None = None,
    seconds: float | None = None,
    workers: int = 1,
    progress: TrialProgress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Choice:
    """Choose frames, method and settings by how well demonstrations that were left out are reproduced.

    Parameters
    ----------
    demonstrations
        three or more, over [time, position] or [time, pose]; where every orientation is 0 0 0 1 none was recorded, and
        positions alone are compared
    manifold
        space of their data
    settings
        of the task file: where the search begins, and what stays where nothing is searched
    declared
        those of the demonstrations' frames that are derived
    methods
        of retrieval; None: all, and where every demonstration repeats itself, first the one for such movements
    trials, seconds, workers, progress, clock
        see `run_search`

    Returns
    -------
    Choice
        what was chosen, and all that was tried

    Raises
    ------
    ValueError
        for too few demonstrations, and where nothing could be learned
    """
    derived = DerivedFrames() if declared is None else declared
    if not any(has_orientations(shown) for shown in demonstrations):
        demonstrations, manifold = [positions_alone(shown) for shown in demonstrations], POSITIONS
    space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold)
    phases = phases_of(demonstrations, space)
    candidates = frame_candidates(demonstrations, derived)
    if phases is not None:  # where the hand happens to begin says nothing of a movement that goes on and on
        candidates = DerivedFrames({name: source for name, source in candidates.sources.items() if source.of != HAND})
    names = tuple(demonstrations[0].frames)
    every = DerivedFrames({**derived.sources, **candidates.sources})
    extended = [candidates.extended(shown) for shown in demonstrations]
    turns = extended if phases is None else [one_turn(*item) for item in zip(extended, phases, strict=True)]
    screen = screen_frames(turns, in_order_of_preference(extended, every))
    kept = tuple(screen.shares())
    # The hand is to be exact where frames are that matter: at objects, also where these are derived frames' sources
    objects = tuple(dict.fromkeys(every.sources[n].of if n in every.sources else n for n in kept))
    cycles = 1 if phases is None else max(math.ceil((one[-1] - one[0]) / TURN) for one in phases)
    problem = Problem.of(extended, space, [name for name in objects if name not in (HAND, BASE)], SAMPLES * cycles)
    if methods is None:
        methods = tuple(METHODS) if phases is None else (PERIODIC.name, *METHODS)
    plan = Plan(names, kept, screen.rivals()[:MORE], dict(settings or {}), tuple(methods))
    search = run_search(problem, plan.rounds, trials, seconds, workers, progress, clock)
    _ = search.best  # raises where there is none
    observed = [name for name in names if name not in derived.sources]
    still = tuple(name for name in observed if _moved(extended, name) < STILL)
    return Choice(search, screen, every, names, still, cycles)


def has_orientations(shown: Demonstration) -> bool:
    """Whether any were recorded: every one of a demonstration without is 0 0 0 1."""
    return not (shown.data.shape[1] == 8 and (shown.data[:, 4:] == quaternion.IDENTITY).all())


def positions_alone(shown: Demonstration) -> Demonstration:
    """A demonstration over [time, position] out of one over [time, pose]: where no orientation was recorded."""
    frames = {name: Frame(frame.A[..., :4, :4], frame.b[..., :4]) for name, frame in shown.frames.items()}
    return Demonstration(shown.times, shown.data[:, :4], frames, shown.visible)


def _moved(demonstrations: Sequence[Demonstration], name: str) -> float:
    """How far a frame is from where it was first, at most, m."""
    frames = [shown.frames[name] for shown in demonstrations]
    A = np.concatenate([frame.A.reshape(-1, *frame.A.shape[-2:]) for frame in frames])
    b = np.concatenate([frame.b.reshape(-1, frame.b.shape[-1]) for frame in frames])
    # of a rotation by w, |R - 1| = 2 sqrt(2) sin(w / 2) in the Frobenius norm
    turns = np.linalg.norm(A[:, 1:4, 1:4] - A[0, 1:4, 1:4], axis=(1, 2)) / np.sqrt(2.0)
    return float(np.max(np.linalg.norm(b[:, 1:4] - b[0, 1:4], axis=1) + METRES_PER_RADIAN * turns))
