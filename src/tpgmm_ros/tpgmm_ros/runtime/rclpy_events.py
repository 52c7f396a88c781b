# SPDX-License-Identifier: Apache-2.0
"""rclpy's `EventsExecutor` without what ends a process: callbacks of what is gone, tasks and actions that fail.

See `rclpy_workarounds` for what else is different in rclpy from how it comes.
"""

from __future__ import annotations

import faulthandler
import inspect
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Task
from rclpy.timer import Timer


def silence_destroyed() -> None:
    """From now on nothing that was destroyed is called back.

    `EventsExecutor` learns that something is gone at its next turn, and what is in its queue before that, it still
    calls. The callback then finds itself and others destroyed (`InvalidHandle: cannot use Destroyable`), which ends the
    node: a timer's that publishes, a subscription's that takes what waits, a service's with its response, an action's
    with a goal that nobody can carry out any more.
    """
    for kind, names in _CALLED.items():
        destroy = kind.destroy
        if destroy.__name__ == "silenced":  # once for each process
            continue

        def silenced(
            self: Any, *, destroy: Callable[[Any], None] = destroy, names: Mapping[str, Callable[..., Any]] = names
        ) -> None:
            # what may be running at this moment is kept: the executor holds no reference of its own
            self.called_before = [getattr(self, name) for name in names]
            for name, nothing in names.items():
                setattr(self, name, nothing)
            destroy(self)

        kind.destroy = silenced


def _nothing(*_: Any) -> None:
    pass


def _take_nothing(_: Any) -> None:
    pass


async def _nothing_to_await(*_: Any) -> None:
    pass


#: What the executor calls of each kind of entity, and what it calls once that is destroyed.
_CALLED: Mapping[Any, Mapping[str, Callable[..., Any]]] = {
    Timer: {"callback": _nothing},
    Subscription: {"callback": _take_nothing},  # rclpy counts the arguments
    Service: {"callback": _nothing, "send_response": _nothing},
    # also the goals that had been asked to be carried out
    ActionServer: {"execute": _nothing_to_await, "_execute_goal": _nothing_to_await, "take_data": dict},
}


class NodeExecutor(rclpy_implementation.EventsExecutor):
    """rclpy's `EventsExecutor`, with tasks that may fail.

    Where a task raises and the executor serves one node, the compiled part of rclpy crashes the process
    (`Segmentation fault`), and no node ends in its own words: a controller leaves its last torques as they are. Here,
    `spin_once` raises what a task has raised.

    Parameters
    ----------
    context : Context
        Of the nodes; None: the default one.
    """

    def __init__(self, context: Context | None = None) -> None:
        context = rclpy.get_default_context() if context is None else context
        super().__init__(context)
        context.on_shutdown(self.wake)
        faulthandler.enable()
        self._raised: deque[Exception] = deque()

    def create_task(self, callback: Callable[..., Any], *args: Any, **options: Any) -> Task:
        """Call back at a later turn, after what is in the queue now.

        Parameters
        ----------
        callback
            a function, or a coroutine function
        *args, **options
            for it

        Returns
        -------
        Task
            done when it has returned, and when it has raised
        """

        async def until_done() -> Any:
            try:
                return await callback(*args, **options)
            except Exception as error:
                self._raised.append(error)

        def once() -> Any:
            try:
                return callback(*args, **options)
            except Exception as error:
                self._raised.append(error)

        return super().create_task(until_done if inspect.iscoroutinefunction(callback) else once)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for what is to be done next, and do that.

        Parameters
        ----------
        timeout_sec
            at most so long, s; None: as long as it takes

        Raises
        ------
        Exception
            what a callback or a task has raised
        """
        super().spin_once(timeout_sec)
        if self._raised:
            raise self._raised.popleft()


def guard_waitable(waitable: Any, has_ended: Callable[[], bool], fail: Callable[[Exception], None]) -> None:
    """From now on a waitable tells what it raises, such as an action's server.

    rclpy calls its coroutines by itself, and what they raise ends the process, with all of its nodes.

    Parameters
    ----------
    waitable
        of a node
    has_ended
        whether it is not to be called any more
    fail
        gets what it raised
    """

    def telling(call: Callable[..., Any]) -> Callable[..., Any]:
        async def told(*args: Any) -> Any:
            try:
                return None if has_ended() else await call(*args)
            except Exception as error:
                fail(error)

        return told

    for name in ("execute", "_execute_goal"):
        if hasattr(waitable, name):
            setattr(waitable, name, telling(getattr(waitable, name)))
