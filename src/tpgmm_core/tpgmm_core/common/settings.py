# SPDX-License-Identifier: Apache-2.0
"""Settings with a meaning and a range: said once, checked everywhere, and shown to users as they stand here.

@dataclass(frozen=True, slots=True, kw_only=True)
class SomeConfig(Settings):
    hold_time: float = setting(2.0, 0.0, 60.0, "A lost frame keeps its confidence for this long, s")
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from typing import Any

from tpgmm_core.common.text import listed, shown


@dataclass(frozen=True, slots=True)
class Setting:
    """What is known of a number: its default, inclusive bounds, and a sentence that ends with its unit."""

    default: float
    lower: float
    upper: float
    description: str


def setting(default: float, lower: float, upper: float, description: str) -> Any:
    """Make a dataclass field that is a number with a range and a description.

    Parameters
    ----------
    default
        the value where none is given
    lower, upper
        smallest and largest value allowed, both inclusive
    description
        a sentence for users, which ends with the unit

    Returns
    -------
    Any
        what `dataclasses.field` returns, with the range and the description as its metadata
    """
    return field(default=default, metadata={"setting": Setting(default, lower, upper, description)})


def setting_of(item: Field[Any]) -> Setting:
    """Return the default, bounds and description that a field was declared with by ``setting``."""
    known: Setting = item.metadata["setting"]
    return known


def configured[ConfigT](config: type[ConfigT], values: Mapping[str, Any]) -> ConfigT:
    """Make a dataclass of settings from some of them by name, as files give them; the others have their defaults.

    Parameters
    ----------
    config
        the dataclass
    values
        name → value

    Returns
    -------
    ConfigT
        an object of that class

    Raises
    ------
    ValueError
        for an unknown name, or a value out of its range
    """
    known = [item.name for item in fields(config)]  # type: ignore[arg-type]
    unknown = [name for name in values if name not in known]
    if unknown:
        raise ValueError(f"unknown settings {listed(unknown)}; known are {', '.join(known)}")
    return config(**values)


def check_settings(config: Any) -> None:
    """Check that all settings of a dataclass are numbers within their ranges.

    Raises
    ------
    ValueError
        for the first one that is not
    """
    for item in fields(config):
        known, value = setting_of(item), getattr(config, item.name)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and known.lower <= value <= known.upper):
            raise ValueError(
                f"{item.name} is {shown(value)}, expected {known.lower:g} to {known.upper:g} ({known.description})"
            )


class Settings:
    """Base of dataclasses of settings, whose numbers are checked when one is made.

    Raises
    ------
    ValueError
        for a number out of its range
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_settings(self)
