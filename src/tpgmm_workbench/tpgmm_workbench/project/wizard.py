# SPDX-License-Identifier: Apache-2.0
"""Proposes a robot file for a URDF that has none: groups, end points, limits, home, and what is suspicious."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Proposal:
    """A robot file.

    Parameters
    ----------
    text
        of the YAML; each line that was guessed says so
    endpoints
        names of the end points
    words
        what was chosen and why
    suspicions
        what is to be checked, as `check_robot` says it
    problem
        why the file cannot be used yet; else empty
    """

    text: str
    endpoints: tuple[str, ...]
    words: tuple[str, ...]
    suspicions: tuple[str, ...] = ()
    problem: str = ""


def known_urdfs() -> tuple[str, ...]:
    """References (package://...) of the URDFs of example-robot-data that are installed, in order of name."""
    raise NotImplementedError


def propose_robot_file(urdf: str) -> Proposal:
    """Propose a robot file.

    Parameters
    ----------
    urdf
        reference, package://NAME/path, as a robot file has it

    Returns
    -------
    Proposal
        to be looked at, and written into a file

    Raises
    ------
    ProjectError
        for a URDF that cannot be read, and a robot without arms (nothing that a chain of joints moves)
    """
    raise NotImplementedError
