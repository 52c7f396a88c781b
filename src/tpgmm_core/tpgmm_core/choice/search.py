# SPDX-License-Identifier: Apache-2.0
"""A search among trials, in rounds, within a budget; any time it is ended it knows the best so far.

The trials of a round do not depend on each other and run side by side; the next round starts from the best ones. A
trial whose error cannot become one of the best any more is given up. So neither the number of workers nor the order in
which they finish changes what is chosen from the same number of trials.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

from tpgmm_core.choice.trial import Problem, Trial, TrialResult
from tpgmm_core.common.side_by_side import side_by_side

LEADERS = 3
"""So many of the best are never given up: the next round starts from them."""
AS_GOOD = 0.01
"""Trials whose merits differ by less than this share are as good; the likelihood of what was left out then decides."""

type TrialProgress = Callable[[TrialResult, TrialResult], None]
"""Called after each trial with its result, and the best so far."""


@dataclass
class Search:
    """What was tried, and what is the best of it.

    Attributes
    ----------
    results
        of all trials, in the order in which they were asked for
    ended
        why no more was tried: "complete", "trials", "time" or "interrupted"
    """

    results: list[TrialResult] = field(default_factory=list)
    ended: str = "complete"

    @property
    def leaders(self) -> list[TrialResult]:
        """The best of all that are complete, best first; of equals, what was asked for first."""
        return sorted((result for result in self.results if result.is_complete), key=lambda result: result.merit)

    @property
    def best(self) -> TrialResult:
        """The one with the least merit; of those of the same method and frames that are as good, the likeliest.

        Raises
        ------
        ValueError
            where no trial was successful, with the reason of the first
        """
        leaders = self.leaders
        if not leaders:
            reasons = [reason for result in self.results for reason in result.refusals]
            raise ValueError(
                "no model could be learned with the settings that were tried: "
                f"{reasons[0] if reasons else 'the time was too short'}"
            )
        first = leaders[0]
        rivals = [
            result
            for result in leaders
            if result.merit <= (1.0 + AS_GOOD) * first.merit
            and (result.trial.method, set(result.trial.frames)) == (first.trial.method, set(first.trial.frames))
        ]
        return max(rivals, key=lambda r: (-math.inf if math.isnan(r.log_likelihood) else r.log_likelihood, -r.merit))

    def limits(self, deadline: float) -> tuple[float, float]:
        """Merit beyond which, and time after which, a trial is of no use: as long as nothing is known, all are."""
        leaders = self.leaders
        return leaders[LEADERS - 1].merit if len(leaders) >= LEADERS else math.inf, deadline if leaders else math.inf


type Rounds = Callable[[Search], Iterable[Sequence[Trial]]]
"""Rounds of trials, of which each may depend on the results of those before."""


def run_search(
    problem: Problem,
    rounds: Rounds,
    trials: int | None = None,
    seconds: float | None = None,
    workers: int = 1,
    progress: TrialProgress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Search:
    """Try what rounds ask for, each trial once, until they end or a budget is used up.

    Parameters
    ----------
    problem
        what trials are judged by
    rounds
        what to try
    trials
        at most so many
    seconds
        no trial is begun after this time, and those that go on are given up; the first one is always finished
    workers
        processes, or what a backend of joblib's takes for them: see `side_by_side`
    progress
        see `TrialProgress`
    clock
        returns a time in s; only differences count, so that clocks of machines may differ

    Returns
    -------
    Search
        KeyboardInterrupt ends it too, once one trial is complete
    """
    search = Search()
    deadline = math.inf if seconds is None else clock() + seconds
    done: set[object] = set()
    try:
        for asked in rounds(search):
            new = []
            for trial in asked:
                if trial.key not in done and (trials is None or len(done) < trials):
                    done.add(trial.key)
                    new.append(trial)
            _run_round(search, problem, new, workers, deadline, progress, clock)
            if clock() > deadline and search.leaders:
                search.ended = "time"
                break
            if trials is not None and len(done) >= trials:
                search.ended = "trials"
                break
    except KeyboardInterrupt:
        if not search.leaders:
            raise
        search.ended = "interrupted"
    return search


def _run_round(
    search: Search,
    problem: Problem,
    trials: Sequence[Trial],
    workers: int,
    deadline: float,
    progress: TrialProgress | None,
    clock: Callable[[], float],
) -> None:
    """Results are kept in the order of the trials, whichever is finished first."""
    before = list(search.results)
    found: dict[int, TrialResult] = {}

    def asked() -> Iterator[_Asked]:
        """Each trial with what is known when it is begun."""
        for number, trial in enumerate(trials):
            if clock() > deadline and search.leaders:
                return
            bound, end = search.limits(deadline)
            yield number, trial, bound, end - clock()

    for number, result in side_by_side(partial(_judge, problem, clock), asked(), workers, in_order=False):
        found[number] = result
        search.results = before + [found[i] for i in sorted(found)]  # at once, since `asked` may run in another thread
        if progress is not None and search.leaders:
            progress(result, search.leaders[0])


type _Asked = tuple[int, Trial, float, float]
"""A trial's number, the trial, the merit beyond which it is too poor, and the time that is left, s."""


def _judge(problem: Problem, clock: Callable[[], float], asked: _Asked) -> tuple[int, TrialResult]:
    """Give up what is too poor or too late."""
    number, trial, bound, seconds = asked
    begin = clock()
    return number, problem.judge(trial, lambda merit: merit > bound or clock() - begin > seconds)
