"""A thread for work that takes long, beside the callbacks of a node."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, TypeVar

from rclpy.task import Future

from dyknow_common.ros import DyKnowNode

Result = TypeVar('Result')


class Worker:
    """A thread that runs one function after the other, while the node serves other requests."""

    def __init__(self, node: DyKnowNode, name: str) -> None:
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._finished: SimpleQueue[Future] = SimpleQueue()
        self._wake = node.create_guard_condition(self._resume, callback_group=node.reentrant)

    def close(self) -> None:
        """Wait for the running function, and cancel those after it."""
        self._pool.shutdown(cancel_futures=True)

    async def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Run a function in the thread; return its result or raise its error."""
        finished: Future = Future()
        task = self._pool.submit(function, *arguments)
        task.add_done_callback(lambda _: self._notify(finished))
        await finished
        return task.result()

    def _notify(self, finished: Future) -> None:
        """Wake the node; this runs in the thread of the worker."""
        self._finished.put(finished)
        self._wake.trigger()

    def _resume(self) -> None:
        """Resume the waiting coroutines; futures of rclpy belong to the thread of the node."""
        while not self._finished.empty():
            self._finished.get().set_result(None)
