"""Threads for long computations of a node."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final, TypeVar

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.task import Future

SWITCH_INTERVAL_S: Final = 0.0005
"""The time for which a thread computes before another one that waits for Python may go on."""

Result = TypeVar('Result')


class Background:
    """Threads for long computations, between whose steps the executor runs callbacks.

    Python interrupts a computation within SWITCH_INTERVAL_S when the executor has something to do,
    also in libraries that cannot be sliced. Computations begin in the order of their requests, and
    must not use rclpy. A process that stops does not wait for them.

    Args:
        node: the node.
        threads: their number.
        name: the name of the threads.
    """

    def __init__(self, node: Node, threads: int = 1, name: str = 'background') -> None:
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._requested: SimpleQueue[tuple[Future, Callable[[], Any]] | None] = SimpleQueue()
        self._finished: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._wake = node.create_guard_condition(self._resume, ReentrantCallbackGroup())
        self._threads = [
            Thread(target=self._run, name=f'{name}_{number}', daemon=True)
            for number in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    def close(self, limit_s: float) -> bool:
        """Drop the computations that wait; return True if each thread ends within a time."""
        while not self._requested.empty():
            self._requested.get()
        for _ in self._threads:
            self._requested.put(None)
        for thread in self._threads:
            thread.join(limit_s)
        return not any(thread.is_alive() for thread in self._threads)

    async def run(self, function: Callable[[], Result], *, is_long: bool = True) -> Result:
        """Return the result of a function or raise its error.

        Args:
            function: the computation.
            is_long: False to run it at once, as the thread would take longer.
        """
        if not is_long:
            return function()
        finished: Future = Future()
        self._requested.put((finished, function))
        result: Result = await finished
        return result

    def _run(self) -> None:
        while (request := self._requested.get()) is not None:
            finished, function = request
            try:
                result = function()
            except Exception as error:  # noqa: BLE001 - the coroutine that waits raises it
                self._finished.put(partial(finished.set_exception, error))
            else:
                self._finished.put(partial(finished.set_result, result))
                del result
            # Otherwise, they would live until the next computation.
            del request, finished, function
            try:
                self._wake.trigger()
            except InvalidHandle:
                return  # The node is destroyed.

    def _resume(self) -> None:
        """Resume the waiting coroutines; futures of rclpy belong to the thread of the executor."""
        while not self._finished.empty():
            self._finished.get()()
