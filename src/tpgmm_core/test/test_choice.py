# SPDX-License-Identifier: Apache-2.0
"""The choice of frames, method and settings: what is offered, what is kept, and that the best of all is taken."""

from __future__ import annotations

import math
from collections.abc import Sequence

import joblib
import numpy as np
import pytest

from tpgmm_core import Demonstration, Frame
from tpgmm_core.choice.automatic import choose
from tpgmm_core.choice.candidates import frame_candidates, in_order_of_preference
from tpgmm_core.choice.plan import Plan
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.choice.search import Search, run_search
from tpgmm_core.choice.trial import HeldOutError, Problem, Trial, TrialResult
from tpgmm_core.choice.turns import one_turn, phases_of
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.frame_screen import screen_frames
from tpgmm_core.model.derived_frames import BASE, HAND, DerivedFrames, FrameSource
from wiping import repeated

SPACE = "R1 x R3"
CAUSES = {"hand_start", "object", "bin_unturned"}
"""What the movement is made of; where it leaves the object, that one's turn does not matter either."""
TABLE = Frame(np.eye(4), np.zeros(4))


def turned(place: np.ndarray, rng: np.random.Generator) -> Frame:
    return Frame(quaternion.rotation_matrix(quaternion.normalize(rng.normal(size=4))), place).with_time()


def reach(seed: int, phantoms: int = 0, still: int = 0) -> Demonstration:
    """A hand goes from where it happens to be along an object's axis into it, then above a bin, however that is turned.

    Beside these there are frames that do not matter: `phantoms` anywhere, and `still` that move by some millimetres.
    """
    rng = np.random.default_rng(seed)
    u = np.linspace(0.0, 1.0, 60)[:, None]
    begin, goal = rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.3, 0.3, 3) + [1.0, 0.0, 0.0]
    frames = {"object": turned(rng.uniform(-0.3, 0.3, 3), rng), "bin": turned(goal, rng)}
    knots = np.array([begin, *frames["object"].A[1:, 1:] @ [0.2, 0.0, 0.0] + frames["object"].b[None, 1:]])
    knots = np.array([knots[0], knots[1], frames["object"].b[1:], goal + [0.0, 0.0, 0.1]])
    path = np.column_stack([np.interp(u[:, 0], [0.0, 0.3, 0.6, 1.0], knot) for knot in knots.T])
    path += 0.002 * rng.normal(size=path.shape)
    for i in range(phantoms):
        frames[f"phantom_{i}"] = turned(rng.uniform(-0.3, 1.0, 3), rng)
    for i in range(still):
        place = np.random.default_rng(i).uniform(-0.3, 1.0, 3)
        frames[f"still_{i}"] = Frame(np.eye(3), place + 0.003 * rng.normal(size=3)).with_time()
    return Demonstration(2.0 * u[:, 0], np.column_stack([2.0 * u, path]), frames)


def offered(demonstrations: Sequence[Demonstration]) -> tuple[list[Demonstration], tuple[str, ...], DerivedFrames]:
    derived = frame_candidates(demonstrations)
    extended = [derived.extended(shown) for shown in demonstrations]
    return extended, in_order_of_preference(extended, derived), derived


# Candidates


def test_each_frame_unturned_and_the_hands_start_and_the_base_are_offered() -> None:
    derived = frame_candidates([reach(i) for i in range(4)])
    assert derived.sources == {
        "object_unturned": FrameSource("object", turned=False),
        "bin_unturned": FrameSource("bin", turned=False),
        "hand_start": FrameSource(HAND, turned=False),
        "base": FrameSource(BASE),
    }


def test_what_says_the_same_as_another_frame_is_not_offered() -> None:
    """A table that stands still is as good as the base, and an object that never turns has no unturned one."""
    shown = [
        Demonstration(d.times, d.data, {"table": TABLE, "cup": Frame(np.eye(4), d.frames["bin"].b)})
        for d in map(reach, range(4))
    ]
    assert set(frame_candidates(shown).sources) == {"hand_start"}


def test_what_the_task_file_declares_is_not_offered_again_and_names_are_free() -> None:
    declared = DerivedFrames({"begin": FrameSource(HAND, turned=False)})
    shown = [
        Demonstration(d.times, d.data, {"base": d.frames["bin"], "object": d.frames["object"]})
        for d in map(reach, range(4))
    ]
    found = frame_candidates([declared.extended(d) for d in shown], declared).sources
    assert found["base_"] == FrameSource(BASE) and HAND not in [source.of for source in found.values()]


# Screen


def test_the_screen_keeps_the_frames_that_the_movement_was_made_of() -> None:
    extended, order, _ = offered([reach(i) for i in range(6)])
    shares = screen_frames(extended, order).shares()
    assert set(shares) - {"object_unturned"} == CAUSES
    assert sum(shares.values()) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_phantoms_and_frames_that_hardly_move_are_dropped(seed: int) -> None:
    extended, order, _ = offered([reach(100 * seed + i, phantoms=10, still=10) for i in range(6)])
    assert set(screen_frames(extended, order).shares()) - {"object_unturned"} == CAUSES


def test_relevance_says_when_each_frame_counts() -> None:
    extended, order, _ = offered([reach(i) for i in range(6)])
    relevance = screen_frames(extended, order).relevance(["hand_start", "object", "bin_unturned"])
    np.testing.assert_allclose(np.sum(list(relevance.values()), axis=0), 1.0)
    assert relevance["hand_start"][0] > 0.8 and relevance["object"][5] > 0.8 and relevance["bin_unturned"][9] > 0.8


def test_a_frame_that_is_not_seen_predicts_nothing_then() -> None:
    shown = [reach(i) for i in range(6)]
    late = [Demonstration(d.times, d.data, d.frames, {"object": d.times > 1.5}) for d in shown]
    assert screen_frames(late).relevance(["object", "bin"])["object"][:6].max() == 0.0


# Trials


def problem(demonstrations: int = 5) -> tuple[Problem, Plan]:
    extended, order, _ = offered([reach(i) for i in range(demonstrations)])
    kept = tuple(screen_frames(extended, order).shares())
    plan = Plan(
        ("object", "bin"), kept, order, {"n_components": 5, "reg_covar": 1e-5, "max_iter": 30}, ("regress_product",)
    )
    return Problem.of(extended, SPACE, ("object", "bin")), plan


def test_a_trial_takes_the_settings_that_its_method_has() -> None:
    trial = Trial.of("adapt_regress", ["a"], {"retrieval": "dmp", "stiffness": 300.0, "n_components": 3})
    assert trial.settings == {"n_components": 3}
    assert Trial.of("dmp", ["a"], {"stiffness": 300.0}).settings == {"stiffness": 300.0}
    assert trial.seen_from(["a", "b"]).key == trial.seen_from(["b", "a"]).key != trial.key


def test_errors_are_those_of_the_path_and_at_the_objects() -> None:
    shown = reach(0)
    path = shown.data[:, 1:].copy()
    path[-1] += [0.0, 0.3, 0.0]
    error = HeldOutError.of(path, shown, ["object"])
    assert error.position == pytest.approx(0.3 / math.sqrt(60)) and error.end == pytest.approx(0.3)
    assert error.objects == pytest.approx(0.15) and error.orientation == 0.0
    assert error.cost == pytest.approx(0.5 * (error.position + error.objects))


def test_a_turn_counts_in_the_cost() -> None:
    times = np.linspace(0.0, 1.0, 20)
    still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (20, 1))
    shown = Demonstration(times, np.column_stack([times, still]), {"base": Frame(np.eye(8), np.zeros(8))})
    path = still.copy()
    path[:, 3:] = quaternion.exp([0.0, 0.0, 0.5])
    error = HeldOutError.of(path, shown, [])
    assert error.position == 0.0 and error.orientation == pytest.approx(0.5) and error.cost == pytest.approx(0.05)


def test_a_trial_that_cannot_be_learned_says_why() -> None:
    result = problem()[0].judge(Trial("adapt_regress", ("object",), {"n_components": 10_000}))
    assert not result.is_complete and result.refusals and result.cost == math.inf


def test_too_few_demonstrations_are_refused() -> None:
    with pytest.raises(ValueError, match="at least three demonstrations, got 2: record more"):
        Problem.of([reach(0), reach(1)], SPACE, [])


# Search


@pytest.fixture(scope="module")
def found() -> Search:
    posed, plan = problem()
    return run_search(posed, plan.rounds, trials=25)


def test_the_choice_takes_the_frames_that_the_movement_was_made_of_and_reproduces_better(found: Search) -> None:
    given, best = found.results[0], found.best
    assert given.trial.frames == ("object", "bin") and found.ended == "trials"
    assert set(best.trial.frames) >= CAUSES
    assert best.cost < 0.5 * given.cost
    # and what was chosen also does better in a situation that took no part in the choice
    _, _, derived = offered([reach(i) for i in range(5)])
    shown, new = [derived.extended(reach(i)) for i in range(5)], derived.extended(reach(77))
    costs = []
    for trial in (given.trial, best.trial):
        model = trial.recipe.learn([_seen(d, trial) for d in shown], SPACE)
        costs.append(HeldOutError.of(reproduce(model, _seen(new, trial)), new, ["object"]).cost)
    assert costs[1] < 0.7 * costs[0]


def _seen(shown: Demonstration, trial: Trial) -> Demonstration:
    return Demonstration(shown.times, shown.data, {name: shown.frames[name] for name in trial.frames})


def test_two_processes_choose_what_one_does(found: Search) -> None:
    posed, plan = problem()
    other = run_search(posed, plan.rounds, trials=25, workers=2)
    assert other.best.trial.key == found.best.trial.key and other.best.cost == found.best.cost
    assert [result.trial.key for result in other.results] == [result.trial.key for result in found.results]


def test_a_dask_cluster_chooses_what_one_process_does(found: Search) -> None:
    """The whole search goes through joblib, so that a backend of its own takes it."""
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install dask distributed")
    posed, plan = problem()
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
        joblib.parallel_config("dask"),
    ):
        client.wait_for_workers(2)
        with distributed.get_task_stream(client) as tasks:
            other = run_search(posed, plan.rounds, trials=25, workers=2)
    assert other.best.trial.key == found.best.trial.key and other.best.cost == found.best.cost
    assert len({task["worker"] for task in tasks.data}) == 2


def test_a_budget_of_time_ends_the_search_with_the_best_so_far() -> None:
    posed, plan = problem()
    ticks = iter(range(10_000))
    search = run_search(posed, plan.rounds, seconds=20.0, clock=lambda: float(next(ticks)))
    assert search.ended == "time" and 1 <= len(search.results) < 25
    assert search.best.merit == min(result.merit for result in search.results if result.is_complete)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interruption_leaves_the_best_so_far_and_before_the_first_one_it_ends_all(workers: int) -> None:
    posed, plan = problem()
    done: list[TrialResult] = []

    def progress(result: TrialResult, best: TrialResult) -> None:
        done.append(result)
        if len(done) == 3:
            raise KeyboardInterrupt

    search = run_search(posed, plan.rounds, workers=workers, progress=progress)
    assert search.ended == "interrupted" and len(search.results) == 3 and search.best in search.results

    def at_once(search: Search) -> list[list[Trial]]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_search(posed, at_once)


def test_likelihood_decides_only_between_what_reproduces_as_well() -> None:
    def result(cost: float, likelihood: float, method: str = "dmp") -> TrialResult:
        errors = {0: HeldOutError(cost, 0.0, cost, cost, cost)}
        return TrialResult(Trial(method, ("a",), {"n_components": round(likelihood)}), errors, likelihood)

    assert Search([result(0.1, 1.0), result(0.1005, 2.0)]).best.log_likelihood == 2.0
    assert Search([result(0.1, 1.0), result(0.11, 2.0)]).best.log_likelihood == 1.0
    assert Search([result(0.1, 1.0), result(0.1005, 2.0, "trajectory")]).best.log_likelihood == 1.0


def test_a_frame_has_to_be_worth_its_place() -> None:
    def result(cost: float, *frames: str) -> TrialResult:
        return TrialResult(Trial("dmp", frames), {0: HeldOutError(cost, 0.0, cost, cost, cost)})

    assert Search([result(0.1, "a"), result(0.0995, "a", "b")]).best.trial.frames == ("a",)
    assert Search([result(0.1, "a"), result(0.095, "a", "b")]).best.trial.frames == ("a", "b")


def test_a_search_without_success_says_why() -> None:
    failed = TrialResult(Trial("dmp", ("a",)), {}, is_complete=False, refusals=("too few samples",))
    with pytest.raises(ValueError, match="no model could be learned .* were tried: too few samples"):
        _ = Search([failed]).best


# Movements that repeat


def test_only_where_every_demonstration_repeats_a_phase_is_found() -> None:
    there = [reach(i) for i in range(3)]
    again = [repeated(shown) for shown in there]
    space = Manifold.parse(SPACE)
    assert phases_of(there, space) is None and phases_of([*again[:2], there[2]], space) is None
    phases = phases_of(again, space)
    assert phases is not None
    for shown, phase in zip(again, phases, strict=True):
        turn = one_turn(shown, phase)
        # the way there and back again, whatever the phase at which it begins
        far = np.linalg.norm(turn.data[:, 1:] - shown.data[0, 1:], axis=1)
        assert (
            far.min() < 0.05 and far.max() > 0.9 * np.linalg.norm(shown.data[:, 1:] - shown.data[0, 1:], axis=1).max()
        )


def test_nothing_is_tried_for_movements_that_do_not_repeat_that_was_not_before() -> None:
    """The method for movements that repeat is offered where all do, and only there."""
    shown = [reach(i) for i in range(4)]
    names = {False: "adapt_regress", True: "periodic"}
    for repeats, name in names.items():
        given = [repeated(item, cycles=3) for item in shown] if repeats else shown
        choice = choose(given, SPACE, {"n_components": 3, "reg_covar": 1e-4, "max_iter": 20}, trials=2)
        assert choice.given.trial.method == "adapt_regress"
        assert [result.trial.method for result in choice.search.results[1:]] == [name]
        assert ("hand_start" in choice.screen.names) is not repeats and choice.cycles == (3 if repeats else 1)
