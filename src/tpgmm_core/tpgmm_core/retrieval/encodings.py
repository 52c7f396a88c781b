# SPDX-License-Identifier: Apache-2.0
"""What a model learns of a demonstration [time, data], so that a retrieval method can reproduce the movement.

An encoding turns demonstrations over [time, data] into those that a model is fitted to. It is written into the model's
metadata, texts and numbers, so that a model file says what it needs. Users of a model always give frames over
[time, data].
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.settings import Settings, configured, setting
from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.cycles import TURN
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.dmp import DmpParameters
from tpgmm_core.retrieval.dynamic_features import manifold_with_derivatives, with_derivatives
from tpgmm_core.retrieval.dynamical_system import with_velocity

_WINDOW = "Number of samples in the parabolas that give derivatives; odd"
_KEY = "encoding"


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoding(Settings, ABC):
    """What a model learns of demonstrations; its fields are numbers (see `settings`).

    Attributes
    ----------
    name
        in files
    init
        where EM should start from, if not from the estimator's own default (see `TPGMM`)
    description
        what the rows of the model's data hold
    follows_time
        whether time, or what time leads through, is the first dimension

    Raises
    ------
    ValueError
        for a number out of its range
    """

    name: ClassVar[str]
    init: ClassVar[str | None] = None
    description: ClassVar[str]
    follows_time: ClassVar[bool] = True

    @abstractmethod
    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """The data that a model is fitted to.

        Parameters
        ----------
        demonstration
            data (T, D): time, s, then a point
        manifold
            space of all of it, time included

        Returns
        -------
        Demonstration
            in the same frames

        Raises
        ------
        ValueError
            for a demonstration that cannot be encoded, with the reason
        """

    def finish(self, model: LearnedMixture) -> None:  # noqa: B027  (most have nothing to add)
        """Set what is known ahead of all demonstrations, in a model that was just fitted."""

    @abstractmethod
    def manifold(self, manifold: Manifold) -> Manifold:
        """Space of the model's data, from that of the demonstrations."""

    @abstractmethod
    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """Names of the model's ambient numbers, from those of the demonstrations."""

    def inputs(self, shares: Array, duration: float) -> Array:
        """The model's first dimension at shares (S,) of a movement of a duration, s.

        Parameters
        ----------
        shares
            (S,), 0 to 1
        duration
            s

        Returns
        -------
        Array
            (S,)

        Raises
        ------
        ValueError
            for a model without time
        """
        if not self.follows_time:
            raise ValueError(f"a model of {self.description} has no time")
        return shares * duration

    def metadata(self) -> dict[str, str | float]:
        """The encoding as a model keeps it: `encoding`, and a number for each option."""
        return {_KEY: self.name, **{f"{_KEY}.{option}": float(value) for option, value in asdict(self).items()}}


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeEncoding(Encoding):
    """[time, data] as demonstrated, or with fewer samples: those nearest to evenly spaced times.

    Durations of states are counted in samples: with the same number of each demonstration, all count alike.
    """

    name: ClassVar[str] = "time"
    description: ClassVar[str] = "[time, data]"
    samples: float = setting(
        0, 0, 100000, "Largest number of samples taken from each demonstration, evenly in time; 0: all"
    )

    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """The demonstration itself, or at most `samples` of its samples."""
        times, n = demonstration.times, int(self.samples)
        if n == 0 or len(times) <= n:
            return demonstration
        even = np.linspace(times[0], times[-1], n)
        return demonstration.at(np.unique(np.abs(times - even[:, None]).argmin(axis=1)))

    def manifold(self, manifold: Manifold) -> Manifold:
        """The same space: nothing is added."""
        return manifold

    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """The same names."""
        return tuple(names)


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodicEncoding(Encoding):
    """[phase, data] of a movement that repeats: the model itself finds the phase, in what all its frames saw."""

    name: ClassVar[str] = "periodic"
    description: ClassVar[str] = "[phase, data]"

    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """The demonstration itself: see `tpgmm_core.learning.cycles`."""
        return demonstration

    def manifold(self, manifold: Manifold) -> Manifold:
        """The same space: the phase takes the place of time."""
        return manifold

    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """The names, with "phase" in place of the time."""
        return ("phase", *names[1:])

    def inputs(self, shares: Array, duration: float) -> Array:
        """Phases (S,), rad, at shares (S,) of a cycle, whatever the duration."""
        return TURN * shares


@dataclass(frozen=True, slots=True, kw_only=True)
class DerivativesEncoding(Encoding):
    """[time, data, velocity, acceleration], by `with_derivatives`."""

    name: ClassVar[str] = "derivatives"
    description: ClassVar[str] = "[time, data, velocity, acceleration]"
    window: float = setting(9, 3, 999, _WINDOW)

    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """The demonstration with velocities and accelerations: see `with_derivatives`."""
        return with_derivatives(demonstration, manifold, int(self.window))

    def manifold(self, manifold: Manifold) -> Manifold:
        """The space with R^n for the velocity and R^n for the acceleration."""
        return manifold_with_derivatives(manifold)

    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """The names, then those of the tangent dimensions with "v_" and with "a_" before them."""
        tangent = _tangent_names(names[1:], _data(manifold))
        return (*names, *(f"v_{name}" for name in tangent), *(f"a_{name}" for name in tangent))


@dataclass(frozen=True, slots=True, kw_only=True)
class DmpEncoding(Encoding):
    """[s, attractor] of a spring-damper, by `DmpParameters.encode`."""

    name: ClassVar[str] = "dmp"
    init: ClassVar[str | None] = "bins"  # s is not even in time
    description: ClassVar[str] = "[decay term, attractor]"
    decay_rate: float = setting(3.0, 0.1, 20.0, "The decay term falls to exp(-decay_rate) within the duration")
    stiffness: float = setting(400.0, 10.0, 10000.0, "Stiffness of the spring, per duration squared")
    window: float = setting(9, 3, 999, _WINDOW)

    @property
    def parameters(self) -> DmpParameters:
        """The numbers that encoding and reproduction share."""
        return DmpParameters(decay_rate=self.decay_rate, stiffness=self.stiffness)

    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """The attractor over the decay term: see `DmpParameters.encode`."""
        return self.parameters.encode(demonstration, manifold, int(self.window))

    def manifold(self, manifold: Manifold) -> Manifold:
        """The same space: s takes the place of time, the attractor that of the data."""
        return manifold

    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """The names, with "decay" in place of the time."""
        return ("decay", *names[1:])

    def inputs(self, shares: Array, duration: float) -> Array:
        """Decay terms (S,) at shares (S,) of the movement, whatever the duration."""
        return np.asarray(np.exp(-self.decay_rate * shares))


_CLOSED = 0.1
"""A path is closed where it ends nearer to its beginning than this share of how far it goes away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityEncoding(Encoding):
    """[data, velocity] without time, by `with_velocity`."""

    name: ClassVar[str] = "velocity"
    init: ClassVar[str | None] = "bins"
    description: ClassVar[str] = "[data, velocity]"
    follows_time: ClassVar[bool] = False
    window: float = setting(9, 3, 999, _WINDOW)

    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """Data and velocity without time: see `with_velocity`.

        Returns
        -------
        Demonstration
            over [data, velocity]

        Raises
        ------
        ValueError
            for a path that is closed, and what `with_velocity` refuses
        """
        data, points = _data(manifold), demonstration.data[:, 1:]
        away = np.linalg.norm(data.log(points[0], points), axis=-1)
        if away[-1] < _CLOSED * away.max():
            raise ValueError(
                f"ends {away[-1]:.3g} from where it began, and goes {away.max():.3g} away in between: a method without "
                "time would be at the goal from the start; choose one that follows time, such as dmp or trajectory"
            )
        return with_velocity(demonstration, manifold, int(self.window))

    def manifold(self, manifold: Manifold) -> Manifold:
        """The space of the data without time, and R^n for the velocity."""
        data = _data(manifold)
        return Manifold((*data.factors, ("R", data.tangent_dim)))

    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """The names without that of the time, then those of the tangent dimensions with "v_" before them."""
        return (*names[1:], *(f"v_{name}" for name in _tangent_names(names[1:], _data(manifold))))


ENCODINGS: dict[str, type[Encoding]] = {
    encoding.name: encoding
    for encoding in (TimeEncoding, PeriodicEncoding, DerivativesEncoding, DmpEncoding, VelocityEncoding)
}


def encoding_of(model: LearnedMixture) -> Encoding:
    """The encoding of a model's data, from its metadata; [time, data] where these name none.

    Parameters
    ----------
    model
        with metadata

    Returns
    -------
    Encoding
        with its options

    Raises
    ------
    ValueError
        for an encoding that is not known, or options that do not fit it
    """
    metadata: Mapping[str, str | float] = model.metadata_
    name = current_name(str(metadata.get(_KEY, TimeEncoding.name)))
    if name not in ENCODINGS:
        raise ValueError(f"the model encodes {shown(name)}, known are {', '.join(ENCODINGS)}: train it again")
    options = {key.removeprefix(f"{_KEY}."): value for key, value in metadata.items() if key.startswith(f"{_KEY}.")}
    return configured(ENCODINGS[name], options)


def _data(manifold: Manifold) -> Manifold:
    return manifold.subset(range(1, manifold.dim))


def _tangent_names(names: Sequence[str], manifold: Manifold) -> list[str]:
    """Names of tangent dimensions: those of the Euclidean ones, and rx, ry, rz for a turn (rx2, ... for the second)."""
    tangent = [""] * manifold.tangent_dim
    for there, here in zip(manifold.flat_tangent, manifold.flat_ambient, strict=True):
        tangent[there] = names[here]
    for i, sphere in enumerate(manifold.spheres):
        tangent[sphere.tangent] = [f"r{axis}{i + 1 if i else ''}" for axis in "xyz"]
    return tangent
