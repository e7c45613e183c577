"""The order of all work on a formula group, partly in the background."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

from rclpy.task import Future

from dyknow_common.ros import Background, DyKnowNode

MAX_QUEUED_STATES: Final = 1000

HEAVY_PARTS: Final = 1000
"""The parts of formulas from which on work that concerns all of them takes tens of milliseconds."""

HEAVY_TEXT: Final = 1000
"""The characters of a formula from which on it takes tens of milliseconds to parse it."""

HEAVY_STEP_S: Final = 0.02
"""The time of the latest step from which on the next one happens in the background."""

Result = TypeVar('Result')


class GroupWork:
    """Runs one piece of work of a group at a time: light work at once, heavy in the background.

    While heavy work runs, requests and states wait. Requests are served first.
    """

    def __init__(self, node: DyKnowNode, background: Background) -> None:
        self.is_busy = False
        self._node = node
        self._background = background
        self._requests: deque[Future] = deque()
        self._states: deque[Callable[[], None]] = deque()

    @property
    def waiting_states(self) -> int:
        """The number of states that wait."""
        return len(self._states)

    async def run(
        self, function: Callable[[], Result], is_heavy: Callable[[], bool] = lambda: False
    ) -> Result:
        """Run a function when it is its turn; return its result or raise its error.

        Args:
            function: the work; if it is heavy, it must not use rclpy.
            is_heavy: called before the work, when nothing else uses the group.
        """
        if self.is_busy:
            turn: Future = Future()
            self._requests.append(turn)
            await turn
        self.is_busy = True
        try:
            return await self._background.run(function, is_long=is_heavy())
        finally:
            self._next()

    def receive(self, process: Callable[[], None]) -> None:
        """Process a state now, or when the group is not busy any more.

        Args:
            process: processes the state; it may use `start` once, as its last step.
        """
        if self.is_busy:
            self._states.append(process)
        else:
            process()

    def receive_first(self, processes: Sequence[Callable[[], None]]) -> None:
        """Process states that came before all those that wait, as `receive` does."""
        self._states.extendleft(reversed(processes))
        if not self.is_busy:
            self._next()

    def start(self, function: Callable[[], Result], finish: Callable[[Result], None]) -> None:
        """Run a function in the background for a state, and then pass on its result."""
        self.is_busy = True
        self._node.spawn(self._run_and_finish, function, finish)

    async def _run_and_finish(
        self, function: Callable[[], Result], finish: Callable[[Result], None]
    ) -> None:
        try:
            finish(await self._background.run(function))
        finally:
            self._next()

    def _next(self) -> None:
        self.is_busy = False
        while not self.is_busy:
            if self._requests:
                self.is_busy = True
                self._requests.popleft().set_result(None)
            elif self._states:
                self._states.popleft()()
            else:
                return
