# SPDX-License-Identifier: Apache-2.0
"""A search among trials, in rounds, within a budget; any time it is ended it knows the best so far.

The trials of a round do not depend on each other and run side by side; the next round starts from the best ones. A
trial whose error cannot become one of the best any more is given up. So neither the number of workers nor the order in
which they finish changes what is chosen from the same number of trials.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field

from tpgmm_core.choice.trial import Problem, Trial, TrialResult

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
                f"nothing that was tried could be learned: {reasons[0] if reasons else 'time is too short'}"
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
        processes; 1 for none beside this one
    progress
        see `TrialProgress`
    clock
        returns a time in s, the same in all processes

    Returns
    -------
    Search
        KeyboardInterrupt ends it too, once one trial is complete
    """
    search = Search()
    deadline = math.inf if seconds is None else clock() + seconds
    done: set[object] = set()
    try:
        with _judges(problem, workers, clock) as judge:
            for asked in rounds(search):
                new = []
                for trial in asked:
                    if trial.key not in done and (trials is None or len(done) < trials):
                        done.add(trial.key)
                        new.append(trial)
                _run_round(search, new, judge, deadline, progress, clock)
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


type _Limits = Callable[[], tuple[float, float]]
type _Judge = Callable[[Iterator[Trial], _Limits], Iterator[tuple[int, TrialResult]]]


def _run_round(
    search: Search,
    trials: Sequence[Trial],
    judge: _Judge,
    deadline: float,
    progress: TrialProgress | None,
    clock: Callable[[], float],
) -> None:
    """Results are kept in the order of the trials, whichever is finished first."""
    first = len(search.results)
    found: dict[int, TrialResult] = {}

    def in_time() -> Iterator[Trial]:
        for trial in trials:
            if clock() > deadline and search.leaders:
                return
            yield trial

    for number, result in judge(in_time(), lambda: search.limits(deadline)):
        found[number] = result
        search.results[first:] = [found[i] for i in sorted(found)]
        if progress is not None and search.leaders:
            progress(result, search.leaders[0])


@contextmanager
def _judges(problem: Problem, workers: int, clock: Callable[[], float]) -> Iterator[_Judge]:
    if workers <= 1:

        def one_by_one(trials: Iterator[Trial], limits: _Limits) -> Iterator[tuple[int, TrialResult]]:
            for number, trial in enumerate(trials):
                yield number, _judge(problem, trial, *limits(), clock)

        yield one_by_one
        return
    with _single_threaded(), _pool(problem, workers) as pool:

        def side_by_side(trials: Iterator[Trial], limits: _Limits) -> Iterator[tuple[int, TrialResult]]:
            running: dict[Future[TrialResult], int] = {}
            for number, trial in enumerate(trials):
                running[pool.submit(_judge_here, trial, *limits(), clock)] = number
                if len(running) >= workers:
                    yield from _finished(running)
            while running:
                yield from _finished(running)

        yield side_by_side


def _finished(running: dict[Future[TrialResult], int]) -> Iterator[tuple[int, TrialResult]]:
    """Wait for one of those that run, at least; they are taken away."""
    for future in wait(running, return_when=FIRST_COMPLETED).done:
        yield running.pop(future), future.result()


def _judge(problem: Problem, trial: Trial, bound: float, deadline: float, clock: Callable[[], float]) -> TrialResult:
    """Give up what is too poor or too late."""
    return problem.judge(trial, lambda merit: merit > bound or clock() > deadline)


# -- in the other processes

_problem: Problem | None = None


def _judge_here(trial: Trial, bound: float, deadline: float, clock: Callable[[], float]) -> TrialResult:
    assert _problem is not None  # set by `_begin`
    return _judge(_problem, trial, bound, deadline, clock)


def _begin(problem: Problem) -> None:
    global _problem
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process decides what an interruption means
    _problem = problem


@contextmanager
def _pool(problem: Problem, workers: int) -> Iterator[ProcessPoolExecutor]:
    # spawned, not forked: a fork of a process with threads (of ROS, of BLAS) may never come to its work
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _begin, (problem,))
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Processes that begin within have one thread each for BLAS and numba: they would fight for the same cores."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    former: Mapping[str, str | None] = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in former.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
