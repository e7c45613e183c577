"""Work that takes long, beside the callbacks of a node."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, TypeVar

from rclpy.task import Future

from dyknow_common.ros import DyKnowNode

Result = TypeVar('Result')


class Worker:
    """A thread that does one thing after the other, while the node answers others.

    Args:
        node: the node that waits for what is done.
        name: of the thread.
    """

    def __init__(self, node: DyKnowNode, name: str) -> None:
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._done: SimpleQueue[tuple[concurrent.futures.Future[Any], Future]] = SimpleQueue()
        self._wake = node.create_guard_condition(self._deliver, callback_group=node.reentrant)

    def close(self) -> None:
        """Waits for what is being done, and forgets what was to be done after it."""
        self._pool.shutdown(cancel_futures=True)

    async def run(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """Does some work in the thread, and returns or raises what comes of it."""
        answer: Future = Future()
        task = self._pool.submit(work, *arguments)
        task.add_done_callback(lambda done: self._finish(done, answer))
        result: Result = await answer
        return result

    def _finish(self, done: concurrent.futures.Future[Any], answer: Future) -> None:
        if not done.cancelled():
            self._done.put((done, answer))
            self._wake.trigger()

    def _deliver(self) -> None:
        """Passes on what is done, in the thread of the node: its futures are for that alone."""
        while not self._done.empty():
            done, answer = self._done.get()
            error = done.exception()
            if error is None:
                answer.set_result(done.result())
            else:
                answer.set_exception(error)
