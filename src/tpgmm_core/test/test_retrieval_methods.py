# SPDX-License-Identifier: Apache-2.0
"""All retrieval methods by name: learned, saved, loaded and reproduced alike; what does not fit is refused."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hidden_world import (
    GOAL,
    HIDDEN_AT,
    SEEN,
    SEEN_AT,
    SETTLED,
    SITUATION,
    START,
    TICK_NS,
    between,
    speeds,
    waiting,
    without,
)
from hidden_world import run as run_in
from reaching import DURATION, reaching_demonstrations, reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.learning import model_file
from tpgmm_core.learning.dirichlet import DirichletTPGMM
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.retrieval.encodings import ENCODINGS, TimeEncoding, encoding_of
from tpgmm_core.retrieval.methods import METHODS, load_model, make_retrieval, method_of
from tpgmm_core.retrieval.recipe import Recipe

MANIFOLD = Manifold.parse("R1 x R3 x S3")
DIMENSIONS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


@cache
def learned(method: str) -> TPGMM:
    recipe = Recipe.of({"n_components": 4, "reg_covar": 1e-5, "retrieval": method})
    return recipe.learn(reaching_demonstrations(20), MANIFOLD, DIMENSIONS)


def run(model: LearnedMixture, seconds: float, **settings: object) -> tuple[np.ndarray, float]:
    """Means (T, 7) of the references to a robot that is at once where it is to be, and the last phase."""
    retrieval = make_retrieval(model, **settings)  # type: ignore[arg-type]
    pose, phase, path = START, 0.0, []
    retrieval.start(0, pose)
    for i in range(1, round(1e9 * seconds) // TICK_NS):
        reference = retrieval.step(i * TICK_NS, SITUATION, pose)
        pose, phase = reference.gaussian.mean, reference.phase
        path.append(pose)
    return np.array(path), phase


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_learned_saved_loaded_and_reproduced_to_the_goal(method: str, tmp_path: Path) -> None:
    learned(method).save(tmp_path / "model.tpgmm")
    model = load_model(tmp_path / "model.tpgmm")
    assert type(model) is METHODS[method].estimator and method_of(model).name == method
    assert model.metadata_ == learned(method).metadata_ and model.metadata_["duration_s"] == pytest.approx(DURATION)
    path, phase = run(model, 1.5 * DURATION)
    assert phase == pytest.approx(1.0, abs=1e-6)
    difference = POSE.log(path[-1], GOAL)
    assert np.linalg.norm(difference[:3]) < 0.02 and np.linalg.norm(difference[3:]) < 0.05
    assert np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1).max() < 0.03  # demonstrated: 0.0047 per tick


@pytest.mark.parametrize("method", METHODS)
def test_every_method_takes_the_duration_that_is_asked_for_and_pauses(method: str) -> None:
    path, phase = run(learned(method), 1.5 * DURATION, duration=0.5 * DURATION)
    assert phase == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(path[round(0.8e9 * DURATION) // TICK_NS, :3] - GOAL[:3]) < 0.03
    paused, phase = run(learned(method), 0.5 * DURATION, speed=0.0)
    assert phase < 0.2 and np.linalg.norm(paused[-1, :3] - START[:3]) < 0.1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("steps", [0, 3])
def test_references_of_every_method_hold_as_many_gaussians_ahead_as_asked_for(method: str, steps: int) -> None:
    retrieval = make_retrieval(learned(method), horizon_steps=steps, horizon_time_step=0.02)
    retrieval.start(0, START)
    reference = retrieval.step(TICK_NS, SITUATION, START)
    assert len(reference.horizon) == steps and reference.horizon_time_step == (0.02 if steps else 0.0)
    assert len(retrieval.horizon(4, 0.01)) == 4


@pytest.mark.parametrize("method", METHODS)
def test_every_method_waits_for_the_frame_that_it_needs_and_then_comes_to_the_goal(method: str) -> None:
    references = run_in(waiting(learned(method)), without("object"), 2.0 * DURATION + 1.0)
    undisturbed = run_in(waiting(learned(method)), SEEN, 2.0 * DURATION + 1.0)
    assert {r.waits for r in undisturbed} == {""}
    waits = between(references, HIDDEN_AT + SETTLED, SEEN_AT)
    assert all(r.waits.startswith("without object the reference is known to ") for r in waits)
    assert waits[0].phase == pytest.approx(waits[-1].phase, abs=5e-3) and waits[-1].phase < 1.0
    assert POSE.log(waits[0].gaussian.mean, waits[-1].gaussian.mean) == pytest.approx(np.zeros(6), abs=5e-3)
    assert waits[-1].frames == ("start",)
    last = between(references, 0.0, HIDDEN_AT)[-1].gaussian.covariance
    ratios = np.linalg.eigvals(np.linalg.solve(last, waits[-1].gaussian.covariance)).real
    assert ratios.max() < 3.0  # 1.7 times the standard deviation: hardly softer than before
    assert not references[-1].waits and references[-1].phase == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(POSE.log(references[-1].gaussian.mean, GOAL)[:3]) < 0.02
    assert speeds(references).max() < 1.2 * speeds(undisturbed).max()


@pytest.mark.parametrize("method", METHODS)
def test_no_method_waits_for_a_frame_that_it_does_not_need_any_more(method: str) -> None:
    references = run_in(waiting(learned(method)), without("start"), 1.5 * DURATION)
    assert {r.waits for r in references} == {""} and references[-1].phase == pytest.approx(1.0, abs=1e-6)


def test_a_file_that_is_replaced_while_it_is_read_gives_one_of_both_models(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, arrays = tmp_path / "model.tpgmm", model_file._arrays

    def replaced_after(path: Path) -> dict[str, object]:
        found = arrays(path)
        learned("semi_markov").save(path)
        return found

    learned("dmp").save(path)
    with monkeypatch.context() as patch:
        patch.setattr(model_file, "_arrays", replaced_after)
        model = load_model(path)
    assert type(model) is METHODS["dmp"].estimator and model.metadata_ == learned("dmp").metadata_
    np.testing.assert_array_equal(model.priors_, learned("dmp").priors_)
    assert type(load_model(path)) is METHODS["semi_markov"].estimator


@pytest.mark.parametrize("encoding", ENCODINGS.values())
def test_an_encoding_names_all_dimensions_and_survives_the_metadata(encoding: type) -> None:
    names = encoding().dimensions(DIMENSIONS, MANIFOLD)
    assert len(names) == len(set(names)) == encoding().manifold(MANIFOLD).dim
    demonstration = encoding().encode(reaching_demonstrations()[0], MANIFOLD)
    assert demonstration.data.shape[1] == len(names)
    model = TPGMM()
    model.metadata_ = encoding().metadata()
    assert encoding_of(model) == encoding()


def test_options_of_an_encoding_are_kept_with_the_model() -> None:
    recipe = Recipe.of({"retrieval": "dmp", "decay_rate": 2.0, "window": 5, "n_components": 3})
    model = recipe.learn(reaching_demonstrations(), MANIFOLD)
    assert encoding_of(model) == recipe.encoding and model.metadata_["encoding.decay_rate"] == 2.0
    model.metadata_["encoding.decay_rate"] = -1.0
    with pytest.raises(ValueError, match="decay_rate is -1.0, expected"):
        encoding_of(model)


def test_a_demonstration_is_thinned_out_evenly_in_time_with_all_that_belongs_to_its_samples() -> None:
    times = np.concatenate([np.linspace(0.0, 1.0, 900, endpoint=False), np.linspace(1.0, 2.0, 50)])
    moving = Frame(np.tile(np.eye(1), (950, 1, 1)), times[:, None]).with_time()
    still = Frame(np.eye(1), [1.0]).with_time()
    whole = Demonstration(
        times, np.column_stack([times, 2.0 * times]), {"moving": moving, "still": still}, {"moving": times > 0.5}
    )
    space = Manifold.parse("R1 x R1")
    thin = TimeEncoding(samples=41).encode(whole, space)
    np.testing.assert_allclose(np.diff(thin.times), 0.05, atol=0.021)
    assert len(thin.times) == 41 and thin.times[0] == 0.0 and thin.times[-1] == 2.0
    np.testing.assert_array_equal(thin.data[:, 1], 2.0 * thin.times)
    np.testing.assert_array_equal(thin.frames["moving"].b[:, 1], thin.times)
    np.testing.assert_array_equal(thin.is_visible("moving"), thin.times > 0.5)
    assert not thin.frames["still"].is_time_varying
    for samples in (0, 950, 2000):
        assert TimeEncoding(samples=samples).encode(whole, space) is whole


def test_states_and_durations_are_learned_of_so_many_samples() -> None:
    assert learned("semi_markov").metadata_["encoding.samples"] == 200
    assert learned("adapt_regress").metadata_["encoding.samples"] == 0
    assert (
        encoding_of(Recipe.of({"samples": 30}, "semi_markov").learn(reaching_demonstrations(), MANIFOLD)).samples == 30
    )


def test_a_model_that_says_nothing_is_one_over_time() -> None:
    assert method_of(reaching_model()).name == "adapt_regress"
    assert make_retrieval(reaching_model(), "regress_product").duration == DURATION


def test_a_way_named_in_settings_gives_way_to_one_that_is_asked_for() -> None:
    assert Recipe.of({"retrieval": "dmp"}, "trajectory").method.name == "trajectory"


@pytest.mark.parametrize(
    ("model", "method", "complaint"),
    [
        ("adapt_regress", "dmp", r"dmp needs a model of \[decay term, attractor\].*\[time, data\].*train"),
        ("dmp", "adapt_regress", r"adapt_regress.*'retrieval: adapt_regress', or choose dmp"),
        ("adapt_regress", "semi_markov", "semi_markov needs a TPHSMM, but this model is a TPGMM"),
        ("adapt_regress", "regression", "no retrieval method 'regression'; known are adapt_regress"),
    ],
)
def test_a_model_that_does_not_suit_is_refused_with_the_reason(model: str, method: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        make_retrieval(learned(model), method)


@pytest.mark.parametrize("method", ["adapt_regress", "regress_product"])
def test_a_mixture_whose_number_of_components_was_found_is_retrieved_as_any_other(method: str) -> None:
    model = DirichletTPGMM(6, init="bins", reg_covar=1e-5, manifold=MANIFOLD).fit(reaching_demonstrations(20))
    model.metadata_["duration_s"] = DURATION
    path, phase = run(model, 1.5 * DURATION, method=method)
    assert phase == 1.0
    np.testing.assert_allclose(path[-1][:3], GOAL[:3], atol=0.02)


def test_a_phase_is_for_functions_of_time_only() -> None:
    functions_of_time = "adapt_regress, regress_product, time_steps, promp, gaussian_process, trajectory"
    with pytest.raises(ValueError, match=f"'arc_length' is for {functions_of_time}: dmp"):
        make_retrieval(learned("dmp"), phase="arc_length")
    with pytest.raises(ValueError, match="no phase 'moon'; known are clock"):
        make_retrieval(learned("adapt_regress"), phase="moon")


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"retrieval": "fortune"}, "no retrieval method 'fortune'"),
        ({"retrieval": "trajectory", "decay_rate": 3.0}, "unknown settings decay_rate of trajectory"),
        ({"max_duration": 30}, "unknown settings max_duration of adapt_regress; it has n_components"),
        ({"retrieval": "dmp", "stiffness": 0.0}, "stiffness is 0.0, expected 10 to"),
    ],
)
def test_a_recipe_says_what_does_not_fit(settings: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Recipe.of(settings)
