# SPDX-License-Identifier: Apache-2.0
"""The four sequences of Figure 5, and what is tried in them: random pushes, and small forces to tell how soft it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.common.types import Array
from tpgmm_demos.figure5.contacts import Record, elbow, gripped_push, push, to_start
from tpgmm_demos.figure5.lessons import HANDS
from tpgmm_demos.figure5.session import Session, Trace, Wrench

CUP, SUGAR = "hold_cup", "hold_sugar"
#: The tasks take hold and the arms come to rest within this time, s.
SETTLE = 2.0
#: A push moves the link within this time, holds it there, and lets go; then it is watched, s.
MOVE, HELD, AFTER = 1.0, 0.6, 1.4
#: By how much hands are to be moved, and elbows, m: people do not get all the way against the robot's resistance.
HAND_WAY, ELBOW_WAY = (0.12, 0.22), (0.06, 0.08)
#: Pushes are flatter than a sphere: beside the weight of the stretched arm the shoulder has some 8 N m left, so that
#: who presses the hand down by 20 cm is stronger than the robot.
FLATTENED = np.array([1.0, 1.0, 0.4])
#: Forces, N, and torques, N m, that tell how soft the robot is: where it is free, and where tasks hold it.
FREE_FORCE, FREE_TORQUE, HELD_FORCE, HELD_TORQUE = 9.0, 2.0, 16.0, 4.0
#: They grow so slowly that inertia and damping do not count, and stay until joints have crept to where friction lets
#: them; what was before is given the time to die out, s.
PROBE_GROWS, PROBE_STAYS, PROBE_REST = 1.5, 3.0, 2.0


@dataclass(frozen=True, slots=True)
class Push:
    """One push, planned.

    "hand" moves the left hand by a way (3,), m; "elbow" moves an elbow by a distance, m, in the direction in which it
    can give way while its hand stays.
    """

    kind: str
    hand: str
    way: Array


@dataclass(frozen=True, slots=True)
class Pushed:
    """One push, done: the link that was pushed, from its beginning to the end of what was watched, and the forces."""

    push: Push
    link: str
    segment: Trace
    record: Record


@dataclass(frozen=True, slots=True)
class Probed:
    """One small force: its name; the link whose motion tells; the wrenches' size, N or N m; and what came of it."""

    name: str
    link: str
    size: float
    segment: Trace


@dataclass(frozen=True, slots=True)
class Sequence:
    """What is done in one sequence.

    Parameters
    ----------
    tasks
        those that hold
    kinds
        of its pushes, whose ways are the same in all sequences
    repeats
        earlier sequences whose forces are repeated
    probed
        whether small forces tell in the end how soft the robot is
    gripped
        whether who pushes has a grip on the hand and keeps it level
    """

    name: str
    title: str
    tasks: tuple[str, ...]
    kinds: tuple[str, ...]
    repeats: tuple[str, ...] = ()
    probed: bool = False
    gripped: bool = False


SEQUENCES = (
    Sequence("cup", "the cup is held level", (CUP,), ("hand",)),
    Sequence("sugar", "the sugar is held above the cup", (SUGAR,), ("elbow",)),
    Sequence("follow", "the left hand is pushed, the right one follows", (SUGAR,), ("hand",), gripped=True),
    Sequence(
        "both",
        "both at once, pushed where no task holds",
        (CUP, SUGAR),
        ("hand", "elbow"),
        repeats=("cup", "follow"),
        probed=True,
    ),
)


@dataclass(frozen=True, slots=True)
class SequenceResult:
    """What happened in one sequence.

    Parameters
    ----------
    rest
        (nv,), the posture in which its tasks took hold
    repeated
        by the name of an earlier sequence, what its forces on the left hand did here
    """

    sequence: Sequence
    rest: Array
    settled: Trace
    pushes: tuple[Pushed, ...]
    repeated: Mapping[str, tuple[Pushed, ...]]
    probes: tuple[Probed, ...]

    @property
    def all_pushes(self) -> tuple[Pushed, ...]:
        """Of the sequence's own, and repeated."""
        return sum(self.repeated.values(), self.pushes)


def random_pushes(count: int, random: np.random.Generator) -> list[Push]:
    """`count` pushes of each kind."""
    pushes = []
    for _ in range(count):
        direction = random.standard_normal(3) * FLATTENED
        pushes.append(Push("hand", "left", random.uniform(*HAND_WAY) * direction / np.linalg.norm(direction)))
    for _ in range(count):
        way = np.array([random.choice([-1.0, 1.0]) * random.uniform(*ELBOW_WAY), 0.0, 0.0])
        pushes.append(Push("elbow", str(random.choice(HANDS)), way))
    return pushes


def run_sequence(
    session: Session,
    sequence: Sequence,
    pushes: list[Push],
    earlier: Mapping[str, SequenceResult],
    choose: Callable[[tuple[str, ...]], None],
    progress: Callable[[], None],
) -> SequenceResult:
    """Lead the hands to the start, let the tasks take hold, push; `choose` says which tasks hold.

    Parameters
    ----------
    earlier
        by name, the sequences whose forces are repeated

    Returns
    -------
    SequenceResult
        what happened
    """
    choose(())
    session.run(1.0)  # what held before lets go
    to_start(session)
    choose(sequence.tasks)
    rest = session.q.copy()
    settled = session.run(SETTLE)
    done = []
    for planned in pushes:
        if planned.kind in sequence.kinds:
            link, wrench = _planned(session, planned, sequence.gripped)
            done.append(_pushed(session, planned, link, wrench))
            progress()
    repeated: dict[str, tuple[Pushed, ...]] = {}
    for name in sequence.repeats:
        for former in earlier[name].pushes:
            again = _pushed(session, former.push, former.link, former.record.repeated)
            repeated[name] = (*repeated.get(name, ()), again)
            progress()
    probes = _probe(session) if sequence.probed else ()
    return SequenceResult(sequence, rest, settled, tuple(done), repeated, probes)


def _planned(session: Session, planned: Push, gripped: bool) -> tuple[str, Wrench]:
    if planned.kind == "elbow":
        link, way = elbow(planned.hand), planned.way[0] * _free_direction(session, planned.hand)
        return push(session, link, way, MOVE)
    return (gripped_push if gripped else push)(session, session.robot.endpoints[planned.hand].frame, planned.way, MOVE)


def _pushed(session: Session, planned: Push, link: str, wrench: Wrench) -> Pushed:
    record = Record(wrench)
    touched = session.run(MOVE + HELD, [(link, record)])
    return Pushed(planned, link, touched.followed_by(session.run(AFTER)), record)


def _free_direction(session: Session, hand: str) -> Array:
    """Where the elbow goes (3,) when the arm moves and its hand does not."""
    robot, data = session.robot, session.data
    data.update(session.q)
    arm = robot.indices(robot.endpoints[hand].joints)
    J_hand = data.jacobian(hand)[:, arm]
    J_elbow = data.frame_jacobian(robot.frame_id(elbow(hand)))[:3, arm]
    way = J_elbow @ np.linalg.svd(J_hand)[2][-1]
    return np.asarray(way / np.linalg.norm(way))


def _probe(session: Session) -> tuple[Probed, ...]:
    left, right = (session.robot.endpoints[hand].frame for hand in HANDS)
    probes = []
    for i, axis in enumerate("xyz"):
        force, torque = np.eye(6)[i], np.eye(6)[3 + i]
        # the cup may turn about the vertical alone
        turn = FREE_TORQUE if axis == "z" else HELD_TORQUE
        for name, size, wrenches in (
            (f"move_{axis}", FREE_FORCE, {left: force}),
            (f"apart_{axis}", HELD_FORCE, {left: -force, right: force}),
            (f"turn_{axis}", turn, {left: torque}),
        ):
            session.run(PROBE_REST)
            contacts = [(link, _growing(size * wrench)) for link, wrench in wrenches.items()]
            probes.append(Probed(name, left, size, session.run(PROBE_GROWS + PROBE_STAYS, contacts)))
    return tuple(probes)


def _growing(wrench: Array) -> Wrench:
    """A wrench that grows to its full size and stays."""
    return lambda time, pose: minimum_jerk(time / PROBE_GROWS) * wrench
