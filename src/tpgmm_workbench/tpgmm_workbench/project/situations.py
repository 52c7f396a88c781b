# SPDX-License-Identifier: Apache-2.0
"""Where frames are, as numbers and as what models take; and how new a situation is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tpgmm_core import Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.methods import make_retrieval
from tpgmm_core.retrieval.novelty import NoveltyScale, SituationRange
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.taught import TaughtDemonstration

#: Up to this share of the newest demonstration, a situation is like them; with fewer demonstrations, that is said with
#: care. Between these numbers of times as far, the number is said.
LIKE, FEW, LITTLE, MOST = 0.5, 6, 1.5, 20.0


def frames_of(situation: Mapping[str, Array]) -> dict[str, Frame]:
    """Frames over [time, pose]; situation: name -> pose (7,) in the base frame."""
    return {name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in situation.items()}


def how_new(score: float, judged_by: int) -> str:
    """What the newness of a situation means, in words.

    Parameters
    ----------
    score
        1: as new as the newest of the demonstrations was to a model of the others
    judged_by
        number of these demonstrations: of few, a low score says little

    Returns
    -------
    str
        begins with "like", "at the edge" or "new"
    """
    if score <= LIKE:
        return "like the demonstrations" + (f", as far as {judged_by} of them can tell" if judged_by < FEW else "")
    if score <= 1.0:
        return "at the edge of what was demonstrated: expect it to be less exact"
    if LITTLE < score < MOST:
        return f"new: {score:.0f} times as far from the demonstrations as any of them from the others"
    more = "a little" if score <= LITTLE else "much"
    return f"new: {more} farther from the demonstrations than any of them from the others"


@dataclass(frozen=True, slots=True, eq=False)
class Newness:
    """How new situations are: to the present model where there is one that knows, else to what was shown.

    Parameters
    ----------
    scale
        of the model; None where it has none
    retrieval
        of the model
    derived, names
        its frames
    seen
        where the frames were otherwise; None where that is one situation at most
    farthest
        the largest distance of those shown from their mean
    """

    scale: NoveltyScale | None = None
    retrieval: Retrieval | None = None
    derived: DerivedFrames | None = None
    names: tuple[str, ...] = ()
    seen: SituationRange | None = None
    farthest: float = 1.0

    @classmethod
    def of(cls, project: Project, shown: Sequence[TaughtDemonstration], but: int = 0) -> Newness:
        """What is known in a project, without one of its demonstrations.

        Parameters
        ----------
        project
            whose present model tells, where it has not learned from that one
        shown
            demonstrations, which tell where there is no such model
        but
            number of the one that is to be judged; 0: none

        Returns
        -------
        Newness
            which may know nothing
        """
        present = project.model
        if present is not None and but not in present.notes.learned_from:
            model = project.load(present)
            scale = NoveltyScale.of_model(model)
            if scale is not None:
                derived = DerivedFrames.of_metadata(model.metadata_)
                return cls(scale, make_retrieval(model, horizon_steps=0), derived, model.frame_names_)
        situations = [frames_of(one.situation) for one in shown]
        names = [name for name in project.task.frames if all(name in frames for frames in situations)]
        if len(situations) < 2 or len(names) < 2:
            return cls()
        seen = SituationRange.of(situations, names, POSE)
        return cls(seen=seen, farthest=max(seen.distance(frames) for frames in situations))

    def of_situation(self, situation: Mapping[str, Array], hand: Array | None = None) -> float | None:
        """How new a situation is.

        Parameters
        ----------
        situation
            name -> pose (7,) in the base frame
        hand
            (7,), where the hand starts; None where not known

        Returns
        -------
        float | None
            1 is as new as the newest so far; None where nothing is known
        """
        frames = frames_of(situation)
        if self.scale is not None and self.retrieval is not None and self.derived is not None:
            every = {**frames, **self.derived.frames(frames, hand)}
            known = {name: every[name] for name in self.names if name in every}
            return self.scale.judge(self.retrieval, known, hand).score
        return None if self.seen is None else self.seen.distance(frames) / max(self.farthest, 1e-9)
