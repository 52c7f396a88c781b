# SPDX-License-Identifier: Apache-2.0
"""Where in a hidden semi-Markov chain a movement is, from the chain and from observations of the robot.

Time is counted in samples of the demonstrations here. A place is a state and its age, the samples since it began.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.hidden_markov.markov import SemiMarkovChain
from tpgmm_core.retrieval import kernels_semi_markov

STANDING = 1e-3
"""What it counts that a sample is a disturbance and the movement stands still, where 1 is a sample that fits a state
as it usually does. A robot is away from a state when it fits it less than this."""
CARRIED = 1e-6
"""Probability per sample that the robot is carried to any later state; three samples there outweigh it."""
LONGEST_HAZARD = 0.5
"""A state never ends with more than this probability per sample, however long it has lasted: durations get a geometric
tail, so that time alone does not force a robot out of a state that it is seen in."""

LEAD = 0.5
"""How far into the next state a reference leads a robot that stays in one for too long, in durations of that state."""


class NominalSchedule:
    """How a movement goes on from any place, when nothing disturbs it.

    Parameters
    ----------
    chain
        no state comes back once it has been left, as in "left-right"

    Attributes
    ----------
    nominal
        (K,), expected durations of the states, scaled such that `total` is whole. (Their most probable durations are
        the same where durations are narrow; but for a state that most demonstrations skip, they would be 1)
    following
        (K,), the most probable next state, or -1
    longest
        (K,), ages at which states are overdue, since the robot is still seen in them: a reference then waits LEAD of
        the next state ahead, which leads a free robot out of the state; infinite for the last one
    after
        (K,), samples from the end of each state to the end of the movement
    first
        the state that the movement begins with
    total
        duration of the movement

    Raises
    ------
    ValueError
        for a chain with a state that comes back
    """

    def __init__(self, chain: SemiMarkovChain) -> None:
        K = len(chain.start)
        if np.linalg.matrix_power(chain.transitions > 0.0, K).any():
            raise ValueError(
                'a movement with an end needs a chain without cycles: fit with transitions="left-right", or with '
                f"an array without cycles; got transitions {chain.transitions.round(3).tolist()}"
            )
        self.following = np.where(chain.transitions.any(axis=1), np.argmax(chain.transitions, axis=1), -1)
        self.first = int(np.argmax(chain.start))
        self.nominal = chain.durations.means
        self.after = np.zeros(K)
        for _ in range(K):  # no way is longer
            self.after = np.where(self.following >= 0, (self.nominal + self.after)[self.following], 0.0)
        expected = float(self.nominal[self.first] + self.after[self.first])
        self.total = max(1.0, float(round(expected)))
        self.nominal, self.after = (self.total / expected * x for x in (self.nominal, self.after))
        self.longest = np.where(self.following >= 0, self.nominal + LEAD * self.nominal[self.following], np.inf)

    def onwards(self, state: int, age: float, samples: float) -> tuple[int, float]:
        """The place some samples after another one; the last state goes on, and overdue ones count as `longest`.

        Parameters
        ----------
        state, age
            the place: a state, and the samples that it has lasted
        samples
            how many later

        Returns
        -------
        tuple[int, float]
            state and age then
        """
        age = min(age, self.longest[state]) + samples
        while self.following[state] >= 0 and age >= self.nominal[state]:
            age -= self.nominal[state]
            state = int(self.following[state])
        return state, age

    def remaining(self, state: int, age: float) -> float:
        """Samples to the end of the movement from a place."""
        return float(max(self.nominal[state] - age, 0.0) + self.after[state])


class StateFilter:
    """Recursive estimate of the state and its age from observations of the robot, one per sample.

    The forward variable of the chain, for three things that may happen in a sample:

    - the movement goes on as it was learned, and the robot is where the state expects it;
    - something holds or pushes the robot away from there, and the movement stands still: STANDING;
    - something carries the robot to a later state, in the middle of it: CARRIED.

    So the movement waits for a robot that is disturbed, catches up with one that is carried ahead, and does not take a
    robot that is pushed away from all states for one that is in another state.

    Parameters
    ----------
    chain
        the states and their durations
    schedule
        how the chain goes on
    """

    def __init__(self, chain: SemiMarkovChain, schedule: NominalSchedule) -> None:
        K, L = len(chain.start), chain.durations.max_duration
        self._onwards = np.ascontiguousarray(chain.transitions)
        self._hazards = np.full((K, L + 1), LONGEST_HAZARD)
        np.minimum(chain.durations.hazards, LONGEST_HAZARD, out=self._hazards[:, :L])
        linked = chain.transitions > 0.0
        reached = linked
        for _ in range(K):
            reached = reached | (reached @ linked)
        self._carried = CARRIED * reached / np.maximum(reached.sum(axis=1, keepdims=True), 1)
        self._middle = np.minimum(0.5 * schedule.nominal, L).astype(np.int64)
        self._remaining = np.maximum(schedule.nominal[:, None] - np.arange(L + 1.0), 0.0) + schedule.after[:, None]
        self._forward, self._ahead = np.zeros((K, L + 1)), np.zeros((K, L + 1))
        self._anything = np.ones(K)
        self.reset(schedule.first, 0.0)
        self.update(None)  # compiled, or loaded from the cache
        self.reset(schedule.first, 0.0)

    def reset(self, state: int, age: float) -> None:
        """Set the place, with certainty."""
        self._forward[:] = 0.0
        self._forward[state, min(round(age), self._forward.shape[1] - 1)] = 1.0

    def update(self, fit: Array | None) -> None:
        """Advance by one sample.

        Parameters
        ----------
        fit
            (K,), how well the robot's position fits each state, 0 to 1, where 1 is usual; None: it was not seen
        """
        likelihood = kernels_semi_markov.advance(
            self._forward, self._hazards, self._onwards, self._carried, self._middle,
            self._anything if fit is None else fit, 0.0 if fit is None else STANDING, self._ahead,
        )  # fmt: skip
        assert likelihood > 0.0  # standing still is always possible
        self._forward, self._ahead = self._ahead, self._forward

    @property
    def probabilities(self) -> Array:
        """Probabilities of the states, (K,)."""
        return self._forward.sum(axis=1)

    @property
    def place(self) -> tuple[int, float]:
        """The most probable state, and its expected age."""
        state = int(np.argmax(self.probabilities))
        ages = np.arange(float(self._forward.shape[1]))
        return state, float(self._forward[state] @ ages / self._forward[state].sum())

    @property
    def remaining(self) -> float:
        """Expected samples to the end of the movement."""
        return float(np.sum(self._forward * self._remaining))
