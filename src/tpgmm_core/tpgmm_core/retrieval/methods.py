# SPDX-License-Identifier: Apache-2.0
"""The retrieval methods by name: what each learns of demonstrations, with which estimator, and how it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.text import shown
from tpgmm_core.learning import model_file
from tpgmm_core.learning.endpoints import EndpointTPGMM
from tpgmm_core.learning.gaussian_process import GaussianProcessTPGMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.learning.promp import ProMPTPGMM
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.retrieval.calibrated import Calibrated, covariance_scale
from tpgmm_core.retrieval.dmp import DynamicMovementPrimitive
from tpgmm_core.retrieval.dynamical_system import StableDynamics
from tpgmm_core.retrieval.encodings import (
    DerivativesEncoding,
    DmpEncoding,
    Encoding,
    PeriodicEncoding,
    TimeEncoding,
    VelocityEncoding,
    encoding_of,
)
from tpgmm_core.retrieval.exact import KEY as EXACT_KEY
from tpgmm_core.retrieval.exact import Constrained, constraints_of
from tpgmm_core.retrieval.interface import Retrieval, TimeParametrized
from tpgmm_core.retrieval.own_end import OwnEnd, end_of
from tpgmm_core.retrieval.periodic import PeriodicPhase, PhaseSteps
from tpgmm_core.retrieval.phase import PHASES, ClockPhase
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct
from tpgmm_core.retrieval.reproduction import Reproduction
from tpgmm_core.retrieval.smooth_trajectory import SmoothTrajectory
from tpgmm_core.retrieval.time_steps import TimeSteps

KEY = "retrieval"
"""Key of the method, in metadata and settings."""

DEFAULT = "adapt_regress"
"""The method of models whose metadata name none."""


SEMI_MARKOV_SAMPLES = 200
"""Samples of each demonstration, for models with durations: the time of learning is quadratic in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrievalMethod:
    """A retrieval method.

    Parameters
    ----------
    name
        in files and parameters
    encoding
        what its models encode
    options
        of the encoding, where they differ from its own defaults
    estimator
        the class of its models
    time_parametrized
        makes the movement as a function of time, which `Reproduction` steps through; or else
    movement
        makes one that has a state of its own, with a duration (s; None: as demonstrated), and the settings of
        references by name
    phase
        for functions of a phase that wraps: how it goes on; None: whatever is asked for, see PHASES
    """

    name: str
    encoding: type[Encoding]
    options: Mapping[str, float] = field(default_factory=dict)
    estimator: type[LearnedMixture] = TPGMM
    time_parametrized: Callable[[LearnedMixture], TimeParametrized] | None = None
    movement: Callable[..., Retrieval] | None = None
    phase: Callable[[LearnedMixture], ClockPhase] | None = None

    @property
    def has_segments(self) -> bool:
        """Whether its models are of few components over time, each a segment of the movement (`segment_frames`)."""
        return issubclass(self.estimator, TPGMM) and self.encoding.follows_time

    @property
    def may_own_end(self) -> bool:
        """Whether its movements end in the last component, unless their end is a Gaussian of its own (`own_end`)."""
        return self.has_segments and not issubclass(self.estimator, EndpointTPGMM)

    @property
    def may_warp_time(self) -> bool:
        """Whether demonstrations have one course from begin to end; those of a movement that repeats have cycles."""
        return self.encoding is not PeriodicEncoding

    def check(self, model: LearnedMixture) -> None:
        """Check that this method can retrieve from a model.

        Raises
        ------
        ValueError
            when it cannot, with the reason and what to do
        """
        found = encoding_of(model)
        if not isinstance(found, self.encoding):
            raise ValueError(
                f"{self.name} needs a model of {self.encoding.description}, but this one encodes "
                f"{found.description}: train one with 'retrieval: {self.name}', or choose "
                f"{' or '.join(method.name for method in ALL_METHODS.values() if isinstance(found, method.encoding))}"
            )
        # Regression takes any mixture over time, also one whose number of components was found by learning
        if self.estimator is not TPGMM and not isinstance(model, self.estimator):
            raise ValueError(
                f"{self.name} needs a {self.estimator.__name__}, but this model is a {type(model).__name__}: "
                f"train one with 'retrieval: {self.name}'"
            )

    def course(self, model: LearnedMixture) -> TimeParametrized | None:
        """The movement as a function of time, which meets the constraints that the model's metadata ask for.

        Parameters
        ----------
        model
            one that `check` accepts

        Returns
        -------
        TimeParametrized | None
            None for methods with a state of their own

        Raises
        ------
        ValueError
            for constraints that the model, or a method that is no function of time, cannot meet
        """
        constraints = constraints_of(model)
        if self.time_parametrized is None or self.phase is not None:
            if constraints:
                functions_of_time = [other.name for other in METHODS.values() if other.time_parametrized]
                raise ValueError(
                    f"{self.name} cannot meet constraints exactly ({EXACT_KEY}: {shown(model.metadata_[EXACT_KEY])}): "
                    f"choose a function of time, {', '.join(functions_of_time)}, or leave them out"
                )
            return None if self.time_parametrized is None else self.time_parametrized(model)
        course = self.time_parametrized(model)
        end = end_of(model, course.manifold)
        course = course if end is None else OwnEnd(course, end)
        return Constrained(course, constraints) if constraints else course


def _dmp(model: LearnedMixture, **settings: Any) -> Retrieval:
    encoding = encoding_of(model)
    assert isinstance(encoding, DmpEncoding) and isinstance(model, EndpointTPGMM)  # checked by `RetrievalMethod.check`
    return DynamicMovementPrimitive(model, encoding.parameters, **settings)


def _semi_markov(model: LearnedMixture, **settings: Any) -> Retrieval:
    # imported when one is made: its optimal control and compiled code cost every program half a second at the start
    from tpgmm_core.retrieval.semi_markov import SemiMarkovMovement

    assert isinstance(model, TPHSMM)
    return SemiMarkovMovement(model, **settings)


METHODS: dict[str, RetrievalMethod] = {
    method.name: method
    for method in (
        RetrievalMethod(name="adapt_regress", encoding=TimeEncoding, time_parametrized=AdaptThenRegress),
        RetrievalMethod(name="regress_product", encoding=TimeEncoding, time_parametrized=RegressThenProduct),
        RetrievalMethod(name="time_steps", encoding=TimeEncoding, estimator=TimeStepTPGMM, time_parametrized=TimeSteps),
        RetrievalMethod(name="promp", encoding=TimeEncoding, estimator=ProMPTPGMM, time_parametrized=TimeSteps),
        RetrievalMethod(
            name="gaussian_process",
            encoding=TimeEncoding,
            estimator=GaussianProcessTPGMM,
            time_parametrized=TimeSteps,
        ),
        RetrievalMethod(name="trajectory", encoding=DerivativesEncoding, time_parametrized=SmoothTrajectory),
        RetrievalMethod(
            name="dynamical_system", encoding=VelocityEncoding, estimator=EndpointTPGMM, movement=StableDynamics
        ),
        RetrievalMethod(name="dmp", encoding=DmpEncoding, estimator=EndpointTPGMM, movement=_dmp),
        RetrievalMethod(
            name="semi_markov",
            encoding=TimeEncoding,
            options={"samples": SEMI_MARKOV_SAMPLES},
            estimator=TPHSMM,
            movement=_semi_markov,
        ),
    )
}


PERIODIC = RetrievalMethod(
    name="periodic",
    encoding=PeriodicEncoding,
    estimator=PeriodicTPGMM,
    time_parametrized=PhaseSteps,
    phase=PeriodicPhase.of,
)
"""For movements that repeat, which have no end of their own. The others learn those that go somewhere."""

ALL_METHODS = {**METHODS, PERIODIC.name: PERIODIC}


def like(name: str) -> tuple[str, ...]:
    """Names of the methods that learn movements of the same kind as the method of a name: with an end, or repeated."""
    return (PERIODIC.name,) if name == PERIODIC.name else tuple(METHODS)


def method_named(name: str) -> RetrievalMethod:
    """The method of a name, or of a name that it had in an earlier version (`old_names`).

    Parameters
    ----------
    name
        of one of ALL_METHODS

    Returns
    -------
    RetrievalMethod
        the method

    Raises
    ------
    ValueError
        for a name that is not known
    """
    current = current_name(name)
    if current not in ALL_METHODS:
        raise ValueError(f"there is no retrieval method {shown(name)}; known are {', '.join(ALL_METHODS)}")
    return ALL_METHODS[current]


def method_of(model: LearnedMixture) -> RetrievalMethod:
    """The method that a model was learned for, from its metadata.

    Parameters
    ----------
    model
        a fitted model

    Returns
    -------
    RetrievalMethod
        the method

    Raises
    ------
    ValueError
        for one that is not known
    """
    return method_named(str(model.metadata_.get(KEY, DEFAULT)))


def make_retrieval(
    model: LearnedMixture,
    method: str | RetrievalMethod | None = None,
    *,
    duration: float | None = None,
    phase: str = "clock",
    speed: float = 1.0,
    horizon_steps: int = 2,
    horizon_time_step: float = 0.005,
    blend_time: float = 0.15,
    calibrated: bool = True,
) -> Retrieval:
    """Make a movement that a loop can step through.

    Parameters
    ----------
    model
        a fitted model
    method
        one of ALL_METHODS by name, or one that was made for a robot; None: what the model was learned for
    duration
        of the movement, s; None: as demonstrated. For a movement that repeats it is that of all cycles together
    phase
        one of PHASES: what the model's time follows; for the methods that are a function of time
    speed
        as for `Reproduction`
    horizon_steps
        as for `Reproduction`
    horizon_time_step, blend_time
        as for `Reproduction`, s
    calibrated
        whether covariances are scaled by what the model says of its calibration (`covariance_scale`), if it does

    Returns
    -------
    Retrieval
        the movement, before its start

    Raises
    ------
    ValueError
        for a model that does not suit the method, and for settings that it cannot have, with the reason
    """
    chosen = method_named(method) if isinstance(method, str) else method or method_of(model)
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
    course = chosen.course(model)
    if phase != "clock" and (course is None or chosen.phase is not None):
        functions_of_time = [other.name for other in METHODS.values() if other.time_parametrized]
        raise ValueError(
            f"the phase {shown(phase)} is for {', '.join(functions_of_time)}: "
            f"{chosen.name} estimates the phase itself; leave 'phase' at 'clock'"
        )
    if course is not None:
        own = PHASES[phase]() if chosen.phase is None else chosen.phase(model)
        retrieval = Reproduction(course, phase=own, **settings)
    else:
        assert chosen.movement is not None
        retrieval = chosen.movement(model, **settings)
    retrieval.speed = speed
    scale = covariance_scale(model, chosen.name) if calibrated else 1.0
    return retrieval if scale == 1.0 else Calibrated(retrieval, scale)


def load_model(path: str | PathLike[str]) -> LearnedMixture:
    """The model in a file, of the class that its method needs; `TPGMM.load` reads all as mixtures.

    Parameters
    ----------
    path
        the file

    Returns
    -------
    LearnedMixture
        a fitted model

    Raises
    ------
    ModelFileError
        for a file that is damaged or no model
    OSError
        for one that cannot be read
    """
    kinds = {method.estimator.__name__: method.estimator for method in ALL_METHODS.values()}
    return model_file.read_as(path, lambda contents: kinds.get(contents.header.kind, TPGMM).from_contents(contents))
