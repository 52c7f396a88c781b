# SPDX-License-Identifier: Apache-2.0
"""`Yielding`: an arm that somebody holds becomes soft, and stiff again once it is let go of; time is an argument.

A force on the hand that lasts is a person (`touch`). The rates of all gains then fall to a share of theirs, which keeps
the damping ratio as it is (`delay_margin`); where the hand is to be stays near the hand (`pose_governor`). So nothing
is stretched that could jump when the person lets go. An interaction that changes the stiffness as a person asks for it
by force: Kronander and Billard 2014, "Learning Compliant Manipulation through Kinesthetic and Tactile Human-Robot
Interaction".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.observation.touch import LETS_GO, Touch

#: Share of the rates of the gains of an arm that is held. K_P is the square of it, and so is the force with which it
#: pulls: what would be felt as a hold by a stiff arm is no less than what counts as one by a soft arm. Otherwise an arm
#: that is held lightly would become stiff and soft by turns.
SOFT = math.sqrt(LETS_GO)
#: The share goes from 1 to 0 within, and from 0 to 1, s. What becomes stiff slowly adds little energy.
SOFTENS, STIFFENS = 0.1, 1.5
#: How the reason for yielding begins: others may take the controller's word for it.
HELD = "the hand is held with more than"


@dataclass(frozen=True, slots=True, kw_only=True)
class YieldConfig(Settings):
    """When an arm yields to somebody who holds its hand."""

    yield_force: float = setting(
        0.0,
        0.0,
        500.0,
        "Force on the hand of `endpoint`, N: above it a person holds the arm, which is soft until it is let go of. For "
        "robots that measure joint torques (effort of joint_states) or external_wrench; 0: never",
    )


class Yielding:
    """See the module.

    Parameters
    ----------
    config
        when it yields

    Attributes
    ----------
    share
        of the rates of the gains, `SOFT` to 1
    """

    def __init__(self, config: YieldConfig) -> None:
        self._touch = Touch(config.yield_force)
        self.forget()

    def configure(self, config: YieldConfig) -> None:
        """Yield to another force from now on; nothing is known of the hand where it is another."""
        if config.yield_force != self._touch.threshold:
            self._touch = Touch(config.yield_force)

    def forget(self) -> None:
        """Start with a hand of which nothing is known."""
        self._touch.forget()
        self.share = 1.0

    @property
    def is_possible(self) -> bool:
        """Whether it yields to any force."""
        return self._touch.threshold > 0.0

    @property
    def is_held(self) -> bool:
        """Whether somebody holds the hand."""
        return self._touch.is_held

    @property
    def reason(self) -> str:
        """Why the arm does not follow, in words; empty where nobody holds the hand."""
        if not self.is_held:
            return ""
        return (
            f"{HELD} {self._touch.threshold:g} N: the arm is soft, and pulled only a little, until it is let go of "
            f"(below {self._touch.free:g} N)"
        )

    @property
    def words(self) -> str:
        """What to add to the reason of an arm that follows; empty where it is as stiff as usual."""
        return ", still softer than usual, because the hand was held" if self.share < 1.0 else ""

    def feel(self, now: float, force: float | None) -> str:
        """Take in the force on the hand.

        Parameters
        ----------
        now
            s
        force
            N; None where it is not known

        Returns
        -------
        str
            why the arm cannot yield at present, in words; empty where it can
        """
        self._touch.take(now, force)
        if self._touch.is_ready or force is None:
            return ""
        return f"a force on the hand from the beginning is no person's: it has to be below {self._touch.free:g} N first"

    def step(self, dt: float) -> None:
        """Change the gains over `dt` s."""
        self.share = max(SOFT, self.share - dt / SOFTENS) if self.is_held else min(1.0, self.share + dt / STIFFENS)
