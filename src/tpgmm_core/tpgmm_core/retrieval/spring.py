# SPDX-License-Identifier: Apache-2.0
"""The critically damped spring, solved exactly, for times of any length."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled


def critically_damped(error: Array, velocity: Array, rate: float, time: float) -> tuple[Array, Array]:
    """Error and velocity after a time, of error'' = -rate² error - 2 rate error'.

    Both die out as exp(-rate t).

    Parameters
    ----------
    error, velocity
        now, (n,)
    rate
        1/s
    time
        s

    Returns
    -------
    tuple[Array, Array]
        error and velocity then, (n,)
    """
    error, velocity = np.array(error, dtype=float), np.array(velocity, dtype=float)
    damp(error, velocity, float(rate), float(time))
    return error, velocity


@compiled
def damp(error: Array, velocity: Array, rate: float, time: float) -> None:
    """`critically_damped`, in place.

    Parameters
    ----------
    error, velocity
        (n,), changed
    rate
        1/s
    time
        s
    """
    left = math.exp(-rate * time)
    for i in range(len(error)):
        slope = velocity[i] + rate * error[i]
        error[i] = left * (error[i] + time * slope)
        velocity[i] = left * (velocity[i] - rate * time * slope)


@compiled
def left_of_two(
    first: Array, first_velocity: Array, first_rate: float, second: Array, second_velocity: Array, second_rate: float,
    time: float, out: Array,
) -> None:  # fmt: skip
    """Sum of the errors of two springs after a time: see `critically_damped`.

    Parameters
    ----------
    first, first_velocity, first_rate
        of one, now, (n,) and 1/s
    second, second_velocity, second_rate
        of the other
    time
        s
    out
        (n,), written
    """
    left, other = math.exp(-first_rate * time), math.exp(-second_rate * time)
    for i in range(len(out)):
        out[i] = left * (first[i] + time * (first_velocity[i] + first_rate * first[i]))
        out[i] += other * (second[i] + time * (second_velocity[i] + second_rate * second[i]))


class Smoothed:
    """A value that follows another one as a critically damped spring: two low-pass filters, one behind the other.

    Of weights that sum to 1 it makes such weights again, since each filter takes a mean.

    Parameters
    ----------
    value
        (n,), where it begins, at rest

    Attributes
    ----------
    value, velocity
        (n,), at present
    """

    def __init__(self, value: Array) -> None:
        self.value = np.array(value)
        self.velocity = np.zeros_like(self.value)

    def follow(self, target: Array, rate: float, seconds: float) -> None:
        """Let a time pass.

        Parameters
        ----------
        target
            (n,), meanwhile
        rate
            of either filter, 1/s
        seconds
            how long, s
        """
        error, self.velocity = critically_damped(self.value - target, self.velocity, rate, seconds)
        self.value = target + error
