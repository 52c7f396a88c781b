# SPDX-License-Identifier: Apache-2.0
"""`train --bases`: a task that is learned with the synergies of another one."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

from tpgmm_core.common.text import listed, one_line
from tpgmm_core.learning.shared_bases import transforms_of
from tpgmm_core.retrieval.methods import load_model
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.task.task_file import Task

COVARIANCE = "semi_tied"


def with_bases(recipe: Recipe, task: Task, path: Path) -> Recipe:
    """The same recipe, for semi-tied covariances with the bases of another model.

    Parameters
    ----------
    recipe
        of the task
    task
        that is learned
    path
        of the other model's file

    Returns
    -------
    Recipe
        whose argument `bases` is the other model

    Raises
    ------
    ValueError
        for a method or a task whose models have no such covariances, other covariances in the task file, and a model
        that encodes something else, has other frames, or no bases.
    OSError
        the file cannot be read.
    """
    estimator = recipe.method.estimator
    if "bases" not in inspect.signature(estimator).parameters:
        raise ValueError(
            f"{recipe.method.name} learns a {estimator.__name__}, whose covariances have no bases: leave out --bases, "
            "or choose another method with --retrieval"
        )
    if not task.space.takes("covariance"):
        raise ValueError("models of kinematic frames have full covariances: leave out --bases")
    named = recipe.arguments.get("covariance", COVARIANCE)
    if named != COVARIANCE:
        raise ValueError(f"--bases needs covariance: {COVARIANCE}, the task file says {named}; change it there")
    other = load_model(path)
    space = task.space.manifold()
    names = recipe.encoding.dimensions(task.space.dimensions(), space)
    if other.dimensions_ is not None and tuple(other.dimensions_) != tuple(names):
        raise ValueError(
            f"{one_line(path)} encodes {listed(other.dimensions_)}, this model {listed(names)}: a basis is of the "
            "same numbers only; train one of them with the --retrieval of the other"
        )
    seen = recipe.encoding.manifold(space)
    try:
        transforms_of(other, dict.fromkeys(task.space.frame_names, seen))
    except ValueError as error:
        raise ValueError(f"{one_line(path)}: {error}") from None
    return replace(recipe, arguments={**recipe.arguments, "covariance": COVARIANCE, "bases": other})
