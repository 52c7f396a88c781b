# SPDX-License-Identifier: Apache-2.0
"""The ways of retrieval by name: what each learns of demonstrations, with which estimator, and how it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

from tpgmm_core.common.text import shown
from tpgmm_core.learning import model_file
from tpgmm_core.learning.ends import GoalTPGMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.retrieval.decay import DecayMovement
from tpgmm_core.retrieval.dynamics import StableDynamics
from tpgmm_core.retrieval.encodings import (
    DecayEncoding,
    DerivativesEncoding,
    Encoding,
    TimeEncoding,
    VelocityEncoding,
    encoding_of,
)
from tpgmm_core.retrieval.interface import Course, Retrieval
from tpgmm_core.retrieval.phase import PHASES
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct
from tpgmm_core.retrieval.reproduction import Reproduction
from tpgmm_core.retrieval.semi_markov import SemiMarkovMovement
from tpgmm_core.retrieval.trajectory import TrajectoryCourse

KEY = "retrieval"
"""Of the way, in metadata and settings."""

DEFAULT = "adapt_regress"
"""The way of models whose metadata name none."""


SEMI_MARKOV_SAMPLES = 200
"""Of each demonstration, for models with durations: the time that learning takes is quadratic in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """A way of retrieval.

    name : in files and parameters
    encoding : what its models encode
    options : of the encoding, where they are other than its own defaults
    estimator : the class that its models have to be of
    course : makes the movement as a function of time, which `Reproduction` steps through; or else
    movement : makes one that has a state of its own, with a duration (s; None: as demonstrated), and the settings of
        references by name
    """

    name: str
    encoding: type[Encoding]
    options: Mapping[str, float] = field(default_factory=dict)
    estimator: type[TPGMM] = TPGMM
    course: Callable[[TPGMM], Course] | None = None
    movement: Callable[..., Retrieval] | None = None

    def check(self, model: TPGMM) -> None:
        """Raises ValueError for a model that this way cannot retrieve from, with the reason and what to do."""
        found = encoding_of(model)
        if not isinstance(found, self.encoding):
            raise ValueError(
                f"{self.name} retrieves from models of {self.encoding.description}, and this one encodes "
                f"{found.description}: train one with 'retrieval: {self.name}', or choose "
                f"{' or '.join(way.name for way in WAYS.values() if isinstance(found, way.encoding))}"
            )
        if not isinstance(model, self.estimator):
            raise ValueError(
                f"{self.name} retrieves from a {self.estimator.__name__}, and this model is a {type(model).__name__}: "
                f"train one with 'retrieval: {self.name}'"
            )


def _decay(model: TPGMM, **settings: Any) -> Retrieval:
    encoding = encoding_of(model)
    assert isinstance(encoding, DecayEncoding) and isinstance(model, GoalTPGMM)  # checked by `Way.check`
    return DecayMovement(model, encoding.law, **settings)


WAYS: dict[str, Way] = {
    way.name: way
    for way in (
        Way(name="adapt_regress", encoding=TimeEncoding, course=AdaptThenRegress),
        Way(name="regress_product", encoding=TimeEncoding, course=RegressThenProduct),
        Way(name="trajectory", encoding=DerivativesEncoding, course=TrajectoryCourse),
        Way(name="dynamics", encoding=VelocityEncoding, estimator=GoalTPGMM, movement=StableDynamics),
        Way(name="decay", encoding=DecayEncoding, estimator=GoalTPGMM, movement=_decay),
        Way(
            name="semi_markov",
            encoding=TimeEncoding,
            options={"samples": SEMI_MARKOV_SAMPLES},
            estimator=TPHSMM,
            movement=SemiMarkovMovement,
        ),
    )
}


def way_named(name: str) -> Way:
    """Raises ValueError for a name that is none of WAYS."""
    if name not in WAYS:
        raise ValueError(f"there is no way of retrieval {shown(name)}; known are {', '.join(WAYS)}")
    return WAYS[name]


def way_of(model: TPGMM) -> Way:
    """The way that a model was learned for, as its metadata say. Raises ValueError for one that is not known."""
    return way_named(str(model.metadata_.get(KEY, DEFAULT)))


def make_retrieval(
    model: TPGMM,
    way: str | None = None,
    *,
    duration: float | None = None,
    phase: str = "clock",
    speed: float = 1.0,
    horizon_steps: int = 2,
    horizon_time_step: float = 0.005,
    blend_time: float = 0.15,
) -> Retrieval:
    """A movement that a loop can step through.

    way : one of WAYS; what the model was learned for where None
    duration : of the movement, s; as demonstrated where None
    phase : one of PHASES: what the model's time follows; for the ways that are a function of time
    speed, horizon_steps, horizon_time_step (s), blend_time (s) : as for `Reproduction`

    Raises ValueError for a model that does not suit the way, and for settings that it cannot have, with the reason.
    """
    chosen = way_of(model) if way is None else way_named(way)
    chosen.check(model)
    if phase not in PHASES:
        raise ValueError(f"there is no phase {shown(phase)}; known are {', '.join(PHASES)}")
    settings: dict[str, Any] = {
        "duration": duration,
        "horizon_steps": horizon_steps,
        "horizon_time_step": horizon_time_step,
        "blend_time": blend_time,
    }
    retrieval: Retrieval
    if chosen.course is not None:
        retrieval = Reproduction(chosen.course(model), phase=PHASES[phase](), **settings)
    else:
        assert chosen.movement is not None
        if phase != "clock":
            raise ValueError(
                f"the phase {shown(phase)} is for {', '.join(w.name for w in WAYS.values() if w.course)}: "
                f"{chosen.name} finds out by itself how far the movement is; leave the phase at 'clock'"
            )
        retrieval = chosen.movement(model, **settings)
    retrieval.speed = speed
    return retrieval


def load_model(path: str | PathLike[str]) -> TPGMM:
    """The model in a file, of the class that its way needs; `TPGMM.load` reads all as mixtures.

    Raises ModelFileError for a file that is damaged or no model, OSError for one that cannot be read.
    """
    kind = model_file.read(path).kind
    return next((way.estimator for way in WAYS.values() if way.estimator.__name__ == kind), TPGMM).load(path)
