# SPDX-License-Identifier: Apache-2.0
"""`Estimator`: constructor arguments as parameters, as scikit-learn knows estimators, without depending on it."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Mapping
from typing import Any, Self

import numpy as np


class Estimator:
    """An object that is its constructor arguments, stored unchanged, until `fit` adds what it learned.

    Names of what was learned end in `_`. What is only cached for speed is left out of copies and pickles. A fitted
    model that is given as an argument (`init`) is data: it is one parameter, and clones keep it fitted.
    """

    @classmethod
    def _parameter_names(cls) -> list[str]:
        return list(inspect.signature(cls).parameters)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Constructor arguments by name.

        Parameters
        ----------
        deep
            makes no difference; scikit-learn passes it

        Returns
        -------
        dict[str, Any]
            name → value
        """
        return {name: getattr(self, name) for name in self._parameter_names()}

    def set_params(self, **params: Any) -> Self:
        """Set constructor arguments by name.

        Parameters
        ----------
        **params
            name and new value of each

        Returns
        -------
        Self
            itself

        Raises
        ------
        ValueError
            for an unknown name; then none is set
        """
        known = self._parameter_names()
        for name in params:
            if name not in known:
                raise ValueError(f"{type(self).__name__} has no parameter {name!r}; it has {', '.join(known)}")
        for name, value in params.items():
            setattr(self, name, value)
        return self

    def _check_integers(self, *names: str, least: int = 1) -> None:
        """Raise ValueError for a parameter that is no integer from `least`."""
        for name in names:
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
                raise ValueError(f"{name} is an integer from {least}, got {value!r}")

    def _check_numbers(self, *names: str, positive: bool = False) -> None:
        """Raise ValueError for a parameter that is no finite number from 0, or above it."""
        for name in names:
            value = getattr(self, name)
            is_number = isinstance(value, int | float | np.number) and np.isfinite(value)
            if not is_number or value < 0.0 or (positive and value == 0.0):
                raise ValueError(f"{name} is a finite number {'above' if positive else 'from'} 0, got {value!r}")

    def __repr__(self) -> str:
        parameters = inspect.signature(type(self)).parameters
        changed = {k: v for k, v in self.get_params().items() if not _is_same(v, parameters[k].default)}
        return f"{type(self).__name__}({', '.join(f'{k}={_shown(v)}' for k, v in changed.items())})"

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_adapters"}

    def __sklearn_clone__(self) -> Self:
        """What `sklearn.base.clone` returns: the same arguments, not fitted."""
        return type(self)(**copy.deepcopy(self.get_params(deep=False)))

    def __sklearn_is_fitted__(self) -> bool:
        return any(name.endswith("_") and not name.startswith("_") for name in vars(self))

    def __sklearn_tags__(self) -> Any:
        """What scikit-learn asks an estimator about itself; only scikit-learn calls it."""
        from sklearn.utils import InputTags, Tags, TargetTags

        return Tags(
            estimator_type=None,
            target_tags=TargetTags(required=False),
            input_tags=InputTags(two_d_array=False, dict=True),
        )


def _is_same(value: Any, default: Any) -> bool:
    if isinstance(value, np.ndarray) or isinstance(default, np.ndarray):
        return value is default
    return value is default or (type(value) is type(default) and bool(value == default))


def _shown(value: Any) -> str:
    if isinstance(value, Estimator):
        return f"<{type(value).__name__}>"
    if isinstance(value, np.ndarray) and value.size > 10:
        return f"<array of shape {value.shape}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_shown(item)}' for key, item in value.items())}}}"
    return repr(value)
