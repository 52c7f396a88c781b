# SPDX-License-Identifier: Apache-2.0
"""`RecedingGains`: gains of a finite horizon in place of those of an infinite one, risk-sensitive if asked for.

The future counts already: the robot grows stiff before the Gaussians do, and begins to turn before the corner. Gains
and feedforward are those of the LQR along the reference's horizon (`lqr.receding_horizon`), `plan_rate` times per
second; the reference itself is followed at every step. Laws of poses and of joints ask the same object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.planning import PlanConfig, Schedule
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.lqr.receding_horizon import RecedingHorizonGains, receding_horizon_gains
from tpgmm_core.model.reference import Reference


@dataclass(frozen=True, slots=True)
class GaussiansAhead:
    """A reference and what comes after it.

    Parameters
    ----------
    gaussians
        the first one is now
    time_step
        s, between them
    """

    gaussians: tuple[Gaussian, ...]
    time_step: float

    @classmethod
    def of(cls, reference: Reference, moving: bool, needed: bool) -> GaussiansAhead:
        """Take the horizon of a reference, or the reference alone where it is not moving.

        Parameters
        ----------
        reference
            with or without a horizon
        moving
            whether its horizon counts
        needed
            whether a reference that moves must have a horizon

        Returns
        -------
        GaussiansAhead
            what gains are made from

        Raises
        ------
        ValueError
            for a horizon that cannot be planned with, or for none where it is needed
        """
        check_horizon(reference, needed)
        horizon = reference.horizon if moving else ()
        return cls((reference.gaussian, *horizon), reference.horizon_time_step)

    @property
    def means(self) -> Array:
        """Means, (T, D)."""
        return np.stack([gaussian.mean for gaussian in self.gaussians])

    @property
    def covariances(self) -> Array:
        """Covariances, (T, n, n)."""
        return np.stack([gaussian.covariance for gaussian in self.gaussians])


class RecedingGains[GainsT]:
    """When the gains of one law are made anew, and what they allow for.

    Parameters
    ----------
    plan
        parameters of planning; may be set at any time
    risk_sensitive
        whether they are; then a reference may come without a horizon, and its Gaussian is used for all times
    """

    def __init__(self, plan: PlanConfig, risk_sensitive: bool = False) -> None:
        self.plan, self.risk_sensitive = plan, risk_sensitive
        self.reset()
        self.along(np.zeros((3, 6)), np.tile(np.eye(6), (3, 1, 1)), 0.1, 1.0)  # compiles

    def reset(self) -> None:
        """Forget the gains; the next ones are made at once."""
        self._schedule = Schedule()
        self._planned: GainsT | None = None

    def course(self, reference: Reference, moving: bool) -> GaussiansAhead:
        """Take what gains are to be made from.

        Parameters
        ----------
        reference
            with a horizon
        moving
            whether its horizon counts

        Returns
        -------
        GaussiansAhead
            see `GaussiansAhead.of`

        Raises
        ------
        ValueError
            for a reference that lacks a horizon, or has a bad one
        """
        return GaussiansAhead.of(reference, moving, needed=not self.risk_sensitive)

    def at_present(self, dt: float, make: Callable[[], GainsT]) -> GainsT:
        """Gains dt s after the last call, made anew when it is time.

        Parameters
        ----------
        dt
            s
        make
            called for new gains

        Returns
        -------
        GainsT
            what `make` has returned last
        """
        if self._schedule.due(dt, self.plan.plan_rate) or self._planned is None:
            self._schedule.begun()
            self._planned = make()
        return self._planned

    def along(
        self, path: Array, covariances: Array, time_step: float, cost: float, **bounds: float
    ) -> RecedingHorizonGains:
        """Gains along Gaussians, with the risk of the plan.

        Parameters
        ----------
        path, covariances, time_step
            as for `receding_horizon_gains`
        cost
            its control cost
        **bounds
            of the stiffness

        Returns
        -------
        RecedingHorizonGains
            those of `receding_horizon_gains`
        """
        return receding_horizon_gains(
            path,
            covariances,
            time_step,
            cost,
            risk_share=self.plan.risk_share if self.risk_sensitive else 0.0,
            risk_stiffness=self.plan.risk_stiffness,
            **bounds,
        )


def check_horizon(reference: Reference, needed: bool) -> None:
    """Check the horizon of a reference.

    Raises
    ------
    ValueError
        for one that cannot be planned with, or for none where it is needed
    """
    if not reference.horizon:
        if needed:
            raise ValueError(
                "the reference has no horizon, which the law 'finite_horizon' plans along; set horizon_steps and "
                "horizon_time_step of the reproduction, or take the law 'infinite_horizon'"
            )
        return
    if not 0.0 < reference.horizon_time_step < np.inf:
        raise ValueError(f"the time step of the horizon is {reference.horizon_time_step} s; expected one above 0")
    manifold = reference.gaussian.manifold
    for ahead in reference.horizon:
        if ahead.manifold != manifold:
            raise ValueError(f"the horizon is on '{ahead.manifold}', the reference on '{manifold}'; expected the same")
        if not (np.isfinite(ahead.mean).all() and np.isfinite(ahead.covariance).all()):
            raise ValueError("the horizon of the reference is not finite")
