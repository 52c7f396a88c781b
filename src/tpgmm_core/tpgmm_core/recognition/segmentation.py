# SPDX-License-Identifier: Apache-2.0
"""Which skills a long recording holds, and when: the most probable sequence (Viterbi) over the chains of all skills.

A segment is a skill from its beginning on, or unknown. From any state of a skill the next segment may begin, at the
rate at which movements end; from its last states, without cost. So a movement that is broken off is found as such,
and costs what that is improbable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.region import squared_radius
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.situation import Situation
from tpgmm_core.recognition.recognizer import UNKNOWN, RecognitionConfig
from tpgmm_core.recognition.skill import Skill, SkillFilter

ENDS = 0.1
"""Share of a skill's states, at its end, after which it is done."""
CHANGE = 1e-3
"""Probability that a movement is broken off, or that unknown ends, within the memory of an observation."""


@dataclass(frozen=True, slots=True)
class Segment:
    """Part of a recording.

    Parameters
    ----------
    name
        of the skill, or UNKNOWN
    first, end
        its first sample, and the one after its last
    """

    name: str
    first: int
    end: int


def segment(
    skills: Sequence[Skill], recording: Demonstration, config: RecognitionConfig | None = None
) -> list[Segment]:
    """The most probable segments of a recording.

    Parameters
    ----------
    skills
        that it may hold
    recording
        over [time, point], with the frames
    config
        as of `Recognizer`; `begins` does not matter

    Returns
    -------
    list[Segment]
        one after the other, from the first sample to the last
    """
    config = config or RecognitionConfig()
    filters = [SkillFilter(skill, config.n_states, 1.0) for skill in skills]
    T, N, S = len(recording.times), config.n_states, len(skills)
    steps = np.diff(recording.times, prepend=recording.times[0] - config.memory)
    densities = _log_densities(filters, recording, config)
    priors = np.array([skill.prior for skill in skills])
    with np.errstate(divide="ignore"):
        log_starts = np.log(np.append((1.0 - config.unknown_prior) * priors / priors.sum(), config.unknown_prior))
    score = np.full(S * N + 1, -math.inf)  # of each state of each skill; the last one is unknown
    score[: S * N : N] = log_starts[:S] + densities[0][:S, 0]
    score[-1] = log_starts[S] + densities[0][S, 0]
    # that what ends has not come to its last states
    breaks = np.append(np.tile(np.arange(N) < N - max(1, round(ENDS * N)), S), True)
    came = np.zeros((T, S * N + 1), dtype=np.int64)  # from which state the best way to each state comes
    is_begun = np.zeros((T, S * N + 1), dtype=bool)  # whether it begins a segment there
    is_begun[0] = True
    states = np.arange(S * N)
    first, final = states % N == 0, states % N == N - 1
    rates = np.repeat([(N - 1) / one.times[-1] for one in filters], N)
    for t in range(1, T):
        change = math.log(CHANGE * min(1.0, steps[t] / config.memory))
        leaving = np.minimum(0.9, steps[t] * rates)
        stay = score[:-1] + np.where(final, 0.0, np.log1p(-leaving))
        move = np.where(first, -math.inf, np.roll(score[:-1] + np.log(leaving), 1))
        came[t, :-1], came[t, -1] = np.where(move > stay, states - 1, states), S * N
        new = np.append(np.maximum(stay, move), score[-1])
        ends = score + np.where(breaks, change, 0.0)
        best = int(np.argmax(ends))
        for state, log_start in zip([*range(0, S * N, N), S * N], log_starts, strict=True):
            if ends[best] + log_start > new[state]:
                new[state], came[t, state], is_begun[t, state] = ends[best] + log_start, best, True
        score = new + np.append(densities[t][:S].ravel(), densities[t][S, 0])
    return _traced(int(np.argmax(score)), came, is_begun, [*(skill.name for skill in skills), UNKNOWN], N)


def _log_densities(filters: Sequence[SkillFilter], recording: Demonstration, config: RecognitionConfig) -> list[Array]:
    """Weighted log-densities (S + 1, N) of each sample in each state; the last row is that of UNKNOWN.

    UNKNOWN has what the state that explains the sample best would give on its border.
    """
    border = squared_radius(config.expected, filters[0].manifold.tangent_dim)
    found: list[Array] = []
    former: Situation | None = None
    steps = np.diff(recording.times, prepend=recording.times[0] - config.memory)
    visible = {name: recording.is_visible(name) for name in recording.frames}
    for t, seconds in enumerate(steps):
        point, weight = recording.data[t, 1:], min(1.0, float(seconds) / config.memory)
        situation = Situation({name: f.at(t) for name, f in recording.frames.items() if visible[name][t]})
        if former is None or not situation.has_frames_of(former):
            for one in filters:
                one.situate(situation.frames, point, None)
            former = situation
        judged = [one for one in filters if one.is_situated]
        floor, highest = 0.0, -math.inf
        for one in judged:
            densities = one.log_densities(point, weight)
            if densities.max() > highest:
                highest = float(densities.max())
                floor = float(one.border_densities(border, weight)[np.argmax(densities)])
        # a skill none of whose frames is seen is as probable as unknown
        rows = [
            one.log_densities(point, weight) if one in judged else np.full(config.n_states, floor) for one in filters
        ]
        found.append(np.vstack([*rows, np.full(config.n_states, floor)]))
    return found


def _traced(
    state: int, came: NDArray[np.int64], is_begun: NDArray[np.bool_], names: Sequence[str], n_states: int
) -> list[Segment]:
    """Segments of the best way to the last state, from its end back."""
    segments: list[Segment] = []
    end = len(came)
    for t in range(end - 1, -1, -1):
        if is_begun[t, state]:
            segments.append(Segment(names[state // n_states], t, end))
            end = t
        state = int(came[t, state])
    return segments[::-1]
