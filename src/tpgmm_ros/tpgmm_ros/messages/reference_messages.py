# SPDX-License-Identifier: Apache-2.0
"""Gaussians, references and terms of torques as messages and back."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence

import numpy as np

from tpgmm_core import Gaussian
from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Gaussian as GaussianMessage
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages.basic_messages import MessageError, floats, header_at
from tpgmm_ros.messages.frame_messages import MAX_DIMENSION, MAX_ITEMS


def gaussian_message(gaussian: Gaussian) -> GaussianMessage:
    """A Gaussian as a message."""
    return GaussianMessage(
        manifold=str(gaussian.manifold),
        mean=floats(gaussian.mean),
        covariance=floats(gaussian.covariance),
    )


def gaussian(message: GaussianMessage) -> Gaussian:
    """The Gaussian of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    Gaussian
        the Gaussian, checked

    Raises
    ------
    MessageError
        for a manifold that is none, sizes that contradict each other, and numbers that are not finite
    """
    dimension = len(message.mean)
    if not 0 < dimension <= MAX_DIMENSION:
        raise MessageError(f"a Gaussian's mean has {dimension} numbers; expected 1 to {MAX_DIMENSION}")
    try:
        manifold = (
            Manifold.euclidean(dimension) if message.manifold == "euclidean" else Manifold.parse(message.manifold)
        )
    except ValueError as error:
        raise MessageError(str(error)) from error
    size = manifold.tangent_dim
    if manifold.dim != dimension or len(message.covariance) != size * size:
        raise MessageError(
            f"a Gaussian on {shown(message.manifold)} holds {dimension} numbers in its mean and "
            f"{len(message.covariance)} in its covariance; expected {manifold.dim} and {size * size}"
        )
    mean, covariance = np.array(message.mean), np.array(message.covariance).reshape(size, size)
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise MessageError("a Gaussian's mean or covariance is not finite")
    try:
        return Gaussian(mean, covariance, manifold)
    except ValueError as error:
        raise MessageError(str(error)) from error


def reference_message(
    reference: Reference, dimensions: Sequence[str], nanoseconds: int, frame_id: str
) -> ReferenceMessage:
    """A reference at a time.

    Parameters
    ----------
    reference
        to be sent
    dimensions
        names of the coordinates of its mean
    nanoseconds
        stamp, ns
    frame_id
        the frame that it is expressed in

    Returns
    -------
    ReferenceMessage
        the message
    """
    return ReferenceMessage(
        header=header_at(nanoseconds, frame_id),
        phase=reference.phase,
        dimensions=list(dimensions),
        gaussian=gaussian_message(reference.gaussian),
        horizon_time_step=reference.horizon_time_step,
        horizon=[gaussian_message(ahead) for ahead in reference.horizon],
        activations=floats(reference.activations),
        frames=list(reference.frames),
    )


def reference(message: ReferenceMessage) -> Reference:
    """The reference of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    Reference
        the reference, checked

    Raises
    ------
    MessageError
        for a Gaussian that is none, and a phase or a time step that is not finite
    """
    if not (np.isfinite(message.phase) and np.isfinite(message.horizon_time_step)):
        raise MessageError(
            f"a reference's phase ({message.phase}) or horizon time step ({message.horizon_time_step}) is not finite"
        )
    if len(message.horizon) > MAX_ITEMS:
        raise MessageError(f"a reference holds {len(message.horizon)} Gaussians ahead; expected {MAX_ITEMS} at most")
    return Reference(
        phase=message.phase,
        gaussian=gaussian(message.gaussian),
        horizon_time_step=message.horizon_time_step,
        horizon=tuple(gaussian(ahead) for ahead in message.horizon),
        activations=np.array(message.activations),
        frames=tuple(message.frames),
        dimensions=tuple(message.dimensions),
    )


def torque_terms(terms: Mapping[str, Array]) -> tuple[list[str], array[float]]:
    """`term_names` and `terms` of a ControllerState, from each term's torques (n,)."""
    return list(terms), floats(np.concatenate([np.zeros(0), *terms.values()]))


def terms_of(message: ControllerState) -> dict[str, Array]:
    """The torques of each term of the law.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    dict[str, Array]
        term → torques (n,), N m, in the order of the message's joints

    Raises
    ------
    MessageError
        as many numbers as no terms of these joints have, a name given twice.
    """
    names, joints = list(message.term_names), len(message.joints)
    if len(message.terms) != len(names) * joints or len(set(names)) != len(names):
        raise MessageError(
            f"{len(message.terms)} numbers for the terms {listed(names)} of {joints} joints; expected "
            f"{len(names) * joints}, and each name once"
        )
    return dict(zip(names, np.array(message.terms).reshape(len(names), joints), strict=True))
