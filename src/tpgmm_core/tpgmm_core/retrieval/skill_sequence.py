# SPDX-License-Identifier: Apache-2.0
"""Skills one after another: each begins where the one before ended, once the robot is there and its frames are seen.

Composition in series (Section 6). A skill is a movement with a model of its own. The reference and its covariance go on
without a jump from one to the next. The first that does not come to its end ends the sequence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.execution import Execution, Stage
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.outcome import ExecutionConfig, Outcome

MAX_HOLD = 600.0
"""s"""


@dataclass(frozen=True, slots=True)
class QueuedSkill:
    """A skill whose turn comes.

    Parameters
    ----------
    name
        for people
    retrieval
        a fresh one of its model
    derived
        frames of the model that are made of others
    hold
        how long the robot stays at its end before the next skill begins, s

    Raises
    ------
    ValueError
        for a time that is none
    """

    name: str
    retrieval: Retrieval
    derived: DerivedFrames = field(default_factory=DerivedFrames)
    hold: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.hold) and 0.0 <= self.hold <= MAX_HOLD):
            raise ValueError(f"hold of {shown(self.name)} is {self.hold!r} s; expected 0 to {MAX_HOLD:g}")

    def frames(
        self, known: Mapping[str, tuple[Frame, float]], start: Array | None
    ) -> tuple[dict[str, Frame], dict[str, float]]:
        """Those of the known frames that its model has learned from, derived ones included.

        Parameters
        ----------
        known
            name → frame over [time, data], and how far it is trusted
        start
            where the hand was when the skill began; None where not known

        Returns
        -------
        tuple[dict[str, Frame], dict[str, float]]
            frames by name, and how far each is trusted
        """
        frames = {name: frame for name, (frame, _) in known.items()}
        weights = {name: weight for name, (_, weight) in known.items()}
        frames |= self.derived.frames(frames, start)
        weights |= self.derived.weights(weights)
        names = [name for name in self.retrieval.frame_names if name in frames]
        return {name: frames[name] for name in names}, {name: weights[name] for name in names}


class _Turn:
    """A skill whose turn it is, or will be as soon as its frames are seen: it sees the world as its model does."""

    def __init__(self, skill: QueuedSkill, execution: Execution, start: Array | None) -> None:
        self.skill, self.execution, self.start = skill, execution, start
        self.frames: dict[str, Frame] = {}
        self._weights: dict[str, float] = {}

    def take(self, known: Mapping[str, tuple[Frame, float]]) -> None:
        self.frames, self._weights = self.skill.frames(known, self.start)

    def step(self, time_ns: int, state: Array | None) -> Reference | None:
        return self.execution.step(time_ns, self.frames, state, self._weights)


class SkillSequence:
    """Steps through skills, from the request to the end of the last one. One skill is a sequence, too.

    A skill begins when the robot has come to the end of the one before (within the tolerances, for its `hold`), and
    when all its frames are seen; the last reference is held until then. Speed changes hold for the skills that follow,
    too. Back is possible to the beginning of the present skill.

    Parameters
    ----------
    skills
        one or more, in this order, of the same manifold
    config
        when each counts as begun and as done
    blend_time
        time constant of the transitions, s: see `Execution.follow`
    state
        (D,), where the robot is; None where not known

    Raises
    ------
    ValueError
        for no skills, and skills of different manifolds

    Attributes
    ----------
    skills
        as given
    index
        of the skill whose references are given, from 0
    outcome
        how the sequence ended; None before
    """

    def __init__(
        self,
        skills: Sequence[QueuedSkill],
        config: ExecutionConfig | None = None,
        blend_time: float = 0.15,
        state: Array | None = None,
    ) -> None:
        if not skills:
            raise ValueError("there are no skills; expected at least one")
        for skill in skills[1:]:
            if skill.retrieval.manifold != skills[0].retrieval.manifold:
                raise ValueError(
                    f"skill {shown(skill.name)} is on {skill.retrieval.manifold}, {shown(skills[0].name)} on "
                    f"{skills[0].retrieval.manifold}: skills of a sequence move the same"
                )
        self.skills = tuple(skills)
        self.index = 0
        self.outcome: Outcome | None = None
        self._config, self._blend_time = config or ExecutionConfig(), blend_time
        self._known: Mapping[str, tuple[Frame, float]] = {}
        self._turn = self._turn_of(0, state)
        self._next: _Turn | None = None

    @property
    def execution(self) -> Execution:
        """Of the skill whose references are given."""
        return self._turn.execution

    @property
    def frames(self) -> dict[str, Frame]:
        """The known ones that this skill has learned from."""
        return self._turn.frames

    @property
    def start(self) -> Array | None:
        """Where the robot was when this skill began; None where not known."""
        return self._turn.start

    @property
    def name(self) -> str:
        """Of this skill."""
        return self._turn.skill.name

    def take_frames(self, known: Mapping[str, tuple[Frame, float]]) -> None:
        """These frames are known now.

        Parameters
        ----------
        known
            name → frame over [time, data], and how far it is trusted, 0 to 1
        """
        self._known = known
        self._turn.take(known)
        if self._next is not None:
            self._next.take(known)

    def step(self, time_ns: int, state: Array | None = None) -> Reference | None:
        """The reference at a time.

        Parameters
        ----------
        time_ns
            now, ns
        state
            (D,), where the robot is; None where not known

        Returns
        -------
        Reference | None
            of the present skill, with its phase; None before the first may begin and while no frame is known

        Raises
        ------
        ValueError
            where the present skill cannot be adapted to the situation
        """
        if self._turn.start is None and state is not None:
            self._turn.start = state
            self._turn.take(self._known)
        reference = self._turn.step(time_ns, state)
        if self.outcome is not None:
            return reference
        outcome = self.execution.outcome
        if outcome is not None and outcome.success and self.index + 1 < len(self.skills):
            return self._go_on(time_ns, state, reference)
        if outcome is not None:
            self._end(outcome, self.index)
        return reference

    def stop(self, time_ns: int, reason: str) -> None:
        """End it here: the reference stays where it is now.

        Parameters
        ----------
        time_ns
            now, ns
        reason
            for the outcome
        """
        if self.outcome is None:
            self.execution.stop(time_ns, reason)
            self._end(Outcome(False, reason), self.index)

    def set_speed(self, speed: float) -> None:
        """Of this skill, and of those that follow.

        Parameters
        ----------
        speed
            1: as learned

        Raises
        ------
        ValueError
            for one that a method cannot go; no skill has changed then
        """
        retrievals = [self.execution.retrieval, *(skill.retrieval for skill in self.skills[self.index + 1 :])]
        before = [retrieval.speed for retrieval in retrievals]
        try:
            for retrieval in retrievals:
                retrieval.speed = speed
        except ValueError:
            for retrieval, former in zip(retrievals, before, strict=True):
                retrieval.speed = former
            raise

    def take_over(self, skill: QueuedSkill, state: Array | None = None, blend_time: float = 0.15) -> None:
        """Continue the present skill with another model or method, without a jump: see `Execution.take_over`.

        Parameters
        ----------
        skill
            in place of the present one
        state
            (D,), where the robot is; None where not known
        blend_time
            time constant with which the difference of the references dies out, s

        Raises
        ------
        ValueError
            for another manifold; the present skill goes on then
        """
        self.execution.take_over(skill.retrieval, state, blend_time)
        self._turn.skill = skill
        self._turn.take(self._known)

    def _turn_of(self, index: int, start: Array | None) -> _Turn:
        skill, is_last = self.skills[index], index + 1 == len(self.skills)
        execution = Execution(skill.retrieval, self._config, None if is_last else skill.hold)
        turn = _Turn(skill, execution, start)
        turn.take(self._known)
        return turn

    def _go_on(self, time_ns: int, state: Array | None, held: Reference | None) -> Reference | None:
        """Let the next skill begin where the present one has ended, as soon as it can."""
        if self._next is None:
            self._next = self._turn_of(self.index + 1, state)
            self._next.execution.follow(self.execution, self._blend_time)
        try:
            reference = self._next.step(time_ns, state)
        except ValueError as error:
            self._end(Outcome(False, f"no reference can be given: {error}"), self.index + 1)
            return held
        if self._next.execution.outcome is not None:
            self._end(self._next.execution.outcome, self.index + 1)
        elif self._next.execution.stage is not Stage.STARTING:
            self._turn, self._next, self.index = self._next, None, self.index + 1
            return reference
        return held

    def _end(self, outcome: Outcome, index: int) -> None:
        many = f"skill {index + 1} of {len(self.skills)} ({self.skills[index].name}): " if len(self.skills) > 1 else ""
        self.outcome = replace(outcome, reason=many + outcome.reason)
