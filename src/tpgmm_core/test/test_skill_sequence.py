# SPDX-License-Identifier: Apache-2.0
"""`SkillSequence`: reach, place and retreat, one after another, without a jump; and what ends it before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest

from reaching import DURATION, demonstrate, frames_at, place
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.derived_frames import HAND, DerivedFrames, FrameSource
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.execution import Stage
from tpgmm_core.retrieval.outcome import ExecutionConfig
from tpgmm_core.retrieval.reproduction import Reproduction
from tpgmm_core.retrieval.skill_sequence import QueuedSkill, SkillSequence

SECOND = 1_000_000_000
TICK_NS = 10_000_000
CONFIG = ExecutionConfig(start_timeout=1.0, settle_time=0.5, stall_timeout=2.0)
PLACES = {"home": place(0.0, 0.0, 0.0), "object": place(0.5, 0.1, 0.4), "target": place(0.6, -0.4, -0.3)}
SPREAD = np.array([0.1, 0.1, 0.0, 0.0, 0.0, 0.4])
LEGS = {"reach": ("home", "object"), "place": ("object", "target"), "retreat": ("target", "home")}
Known = dict[str, tuple[Frame, float]]


@cache
def model(start: str, goal: str) -> TPGMM:
    """A model of a movement from one frame to another, demonstrated with both near PLACES."""
    random, demonstrations = np.random.default_rng(0), []
    for _ in range(6):
        one, other = (POSE.exp(PLACES[name], random.uniform(-1.0, 1.0, 6) * SPREAD) for name in (start, goal))
        shown = demonstrate(one, other, random)
        demonstrations.append(Demonstration(shown.times, shown.data, frames_at(**{start: one, goal: other})))
    made = TPGMM(n_components=7, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(demonstrations)
    made.metadata_ = {"duration_s": DURATION}
    return made


def skill(name: str, hold: float = 0.0) -> QueuedSkill:
    return QueuedSkill(name, Reproduction(model(*LEGS[name])), hold=hold)


def known(**places: Array) -> Known:
    return {name: (frame, 1.0) for name, frame in frames_at(**places).items()}


@dataclass
class Run:
    """A robot that is where the reference was a tick ago, plus an error of its own."""

    sequence: SkillSequence
    error: Array = field(default_factory=lambda: np.zeros(6))
    state: Array | None = None
    tick: int = 0
    references: list[Reference] = field(default_factory=list)
    indices: list[int] = field(default_factory=list)

    def go(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        for _ in range(round(seconds * SECOND / TICK_NS)):
            reference = self.sequence.step(self.tick * TICK_NS, self.state)
            self.tick += 1
            if reference is not None:
                self.references.append(reference)
                self.indices.append(self.sequence.index)
                self.state = POSE.exp(reference.gaussian.mean, self.error)
            if self.sequence.outcome is not None or until():
                return

    @property
    def seconds(self) -> float:
        return self.tick * TICK_NS / SECOND

    def steps(self) -> Array:
        """How far the reference goes in each tick, (T - 1, 6)."""
        means = [reference.gaussian.mean for reference in self.references]
        return np.array([POSE.log(one, other) for one, other in zip(means, means[1:], strict=False)])


def run_of(*skills: QueuedSkill, frames: Known | None = None) -> Run:
    sequence = SkillSequence(skills, CONFIG)
    sequence.take_frames(known(**PLACES) if frames is None else frames)
    return Run(sequence, state=PLACES["home"])


def test_three_skills_are_done_in_their_order_and_the_last_one_ends_the_sequence() -> None:
    run = run_of(skill("reach", hold=0.3), skill("place"), skill("retreat"))
    run.go(12.0)
    outcome = run.sequence.outcome
    assert outcome is not None and outcome.success and outcome.reason.startswith("skill 3 of 3 (retreat): ")
    assert run.indices == sorted(run.indices) and set(run.indices) == {0, 1, 2}
    ends = [run.references[len(run.indices) - 1 - run.indices[::-1].index(i)] for i in range(3)]
    for end, goal in zip(ends, ("object", "target", "home"), strict=True):
        assert end.phase > 0.99
        assert np.linalg.norm(end.gaussian.mean[:3] - PLACES[goal][:3]) < 0.015
    # 3 movements of 2 s, 0.3 s at the object, and the time to settle at the end
    assert run.seconds == pytest.approx(3 * DURATION + 0.3 + CONFIG.settle_time, abs=0.1)


def test_neither_reference_nor_covariance_jumps_where_one_skill_follows_another() -> None:
    run = run_of(skill("reach"), skill("place"), skill("retreat"))
    run.go(12.0)
    steps, size = run.steps(), np.array([np.linalg.norm(r.gaussian.covariance) for r in run.references])
    fastest = np.abs(steps).max()
    for change in np.flatnonzero(np.diff(run.indices)):
        assert np.abs(steps[change]).max() < 0.02 * fastest, "the reference at rest goes on from there"
        assert abs(size[change + 1] / size[change] - 1.0) < 0.02
    # neither velocity nor covariance changes faster there than within the movements
    change = np.flatnonzero(np.diff(run.indices))
    near = np.isin(np.arange(len(steps) - 1), np.concatenate([change + i for i in range(-1, 20)]))
    acceleration = np.abs(np.diff(steps, axis=0)).max(axis=1)
    assert acceleration[near].max() < 1.5 * acceleration[~near].max()


def test_a_skill_that_begins_elsewhere_waits_until_the_reference_has_gone_there_slowly() -> None:
    run = run_of(skill("reach"), skill("retreat"))  # the object is 0.5 m from the target
    run.go(1.0, lambda: run.sequence.index == 1)
    run.go(12.0)
    assert run.sequence.outcome is not None and run.sequence.outcome.success, run.sequence.outcome
    indices = np.array(run.indices)
    way = (indices == 1) & (np.array([r.phase for r in run.references]) == 0.0)
    speed = np.linalg.norm(run.steps()[way[1:]][:, :3], axis=1) * SECOND / TICK_NS
    assert 0.9 * CONFIG.transition_speed < speed.max() < 1.05 * CONFIG.transition_speed
    begun = run.references[int(np.flatnonzero(way)[-1])].gaussian.mean
    assert np.linalg.norm(begun[:3] - PLACES["target"][:3]) < 0.1 * np.linalg.norm(
        (PLACES["target"] - PLACES["object"])[:3]
    )
    assert np.linalg.norm(run.references[-1].gaussian.mean[:3] - PLACES["home"][:3]) < 0.01


def test_the_last_reference_is_held_until_the_next_ones_frames_are_seen() -> None:
    run = run_of(skill("reach"), skill("place"), frames=known(home=PLACES["home"], object=PLACES["object"]))
    run.go(2.0 + 0.5)
    assert run.sequence.index == 0 and run.sequence.execution.stage is Stage.ENDED and run.sequence.outcome is None
    held = run.references[-1].gaussian
    run.sequence.take_frames(known(**PLACES))
    run.go(0.02)
    assert run.sequence.index == 1 and run.sequence.name == "place"
    np.testing.assert_allclose(run.references[-2].gaussian.mean, held.mean, atol=1e-12)
    run.go(5.0)
    assert run.sequence.outcome is not None and run.sequence.outcome.success


def test_frames_of_a_later_skill_that_are_not_seen_in_time_end_it_by_name() -> None:
    run = run_of(skill("reach"), skill("place"), frames=known(home=PLACES["home"], object=PLACES["object"]))
    run.go(6.0)
    outcome = run.sequence.outcome
    assert outcome is not None and not outcome.success
    assert outcome.reason.startswith("skill 2 of 2 (place): frames not seen within 1 s: target;")
    assert run.sequence.step(run.tick * TICK_NS, run.state) is not None, "the robot stays at the object"


def test_a_skill_that_is_not_done_ends_the_sequence_and_no_other_begins() -> None:
    run = run_of(skill("reach"), skill("place"), skill("retreat"))
    run.error = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    run.go(12.0)
    outcome = run.sequence.outcome
    assert outcome is not None and not outcome.success and outcome.is_missed
    assert outcome.reason.startswith("skill 1 of 3 (reach): 20.0 mm") and outcome.position_error == pytest.approx(0.02)
    assert run.sequence.index == 0 and run.seconds == pytest.approx(DURATION + CONFIG.settle_time, abs=0.05)


def test_it_goes_on_once_the_robot_has_been_there_for_the_hold_without_a_break() -> None:
    run = run_of(skill("reach", hold=0.4), skill("place"))
    run.go(5.0, lambda: run.sequence.execution.stage is Stage.SETTLING)
    run.go(0.2)
    run.error = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])  # pushed off
    run.go(0.1)
    run.error = np.zeros(6)  # and back
    back = run.seconds
    run.go(2.0, lambda: run.sequence.index == 1)
    assert run.seconds - back == pytest.approx(0.4, abs=0.03)


def test_a_later_skill_that_cannot_be_adapted_ends_the_sequence_where_the_former_one_ended() -> None:
    run = run_of(skill("reach"), skill("place"))
    run.go(1.0)
    flat = Frame(np.diag([1.0, *np.zeros(7)]), np.zeros(8))
    run.sequence.take_frames({**known(**PLACES), "target": (flat, 1.0)})
    run.go(3.0)
    outcome = run.sequence.outcome
    assert outcome is not None and not outcome.success
    assert outcome.reason.startswith("skill 2 of 2 (place): no reference can be given: ")
    reference = run.sequence.step(run.tick * TICK_NS, run.state)
    assert reference is not None and np.linalg.norm(reference.gaussian.mean[:3] - PLACES["object"][:3]) < 0.01


def test_a_stop_names_the_skill_and_the_first_reason_stays() -> None:
    run = run_of(skill("reach"), skill("place"))
    run.go(3.0)
    assert run.sequence.index == 1
    run.sequence.stop(run.tick * TICK_NS, "canceled")
    run.sequence.stop(run.tick * TICK_NS, "too late")
    assert run.sequence.outcome is not None and run.sequence.outcome.reason == "skill 2 of 2 (place): canceled"


def test_one_skill_is_a_sequence_whose_reason_names_none() -> None:
    run = run_of(skill("reach"))
    run.go(5.0)
    outcome = run.sequence.outcome
    assert outcome is not None and outcome.success and outcome.reason.startswith("0.0 mm")


def test_a_frame_made_of_the_start_is_where_the_hand_was_when_its_skill_began() -> None:
    derived = DerivedFrames({"object": FrameSource(HAND, True)})
    place_from_here = QueuedSkill("place", Reproduction(model("object", "target")), derived)
    places = {**PLACES, "object": place(0.45, 0.2, 0.0)}
    run = run_of(skill("reach"), place_from_here, frames=known(**places))
    run.go(3.0, lambda: run.sequence.index == 1)
    start = run.sequence.frames["object"].b[1:4]
    np.testing.assert_allclose(start, places["object"][:3], atol=0.01)
    assert np.linalg.norm(start - PLACES["home"][:3]) > 0.4


def test_a_speed_holds_for_the_skills_that_follow_and_one_that_cannot_be_is_refused_for_all() -> None:
    run = run_of(skill("reach"), skill("place"))
    run.go(0.5)
    run.sequence.set_speed(2.0)
    assert [one.retrieval.speed for one in run.sequence.skills] == [2.0, 2.0]
    with pytest.raises(ValueError, match="speed"):
        run.sequence.set_speed(float("nan"))
    assert [one.retrieval.speed for one in run.sequence.skills] == [2.0, 2.0]
    run.go(9.0)
    assert run.sequence.outcome is not None and run.sequence.outcome.success
    assert run.seconds < 0.5 + 0.5 * (2 * DURATION) + CONFIG.settle_time


def test_what_is_no_sequence_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="at least one"):
        SkillSequence([])
    flat = TPGMM(n_components=1, reg_covar=1e-3, manifold="R1 x R2").fit(
        [Demonstration(np.arange(3.0), np.column_stack([np.arange(3.0)] * 3), {"home": Frame(np.eye(3), np.zeros(3))})]
    )
    flat.metadata_ = {"duration_s": 2.0}
    with pytest.raises(ValueError, match="'flat' is on R2, 'reach' on R3 x S3"):
        SkillSequence([skill("reach"), QueuedSkill("flat", Reproduction(flat))])
    with pytest.raises(ValueError, match="hold of 'reach' is -1"):
        skill("reach", hold=-1.0)
