"""The work of a group in random orders: it is done in order, and never waits without a reason."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.task import Future

from dyknow_reasoning.ros.group_evaluation import GroupWork


class TroubleError(Exception):
    """A fault in some work."""


class Work:
    """A group's work with a background whose computations end at random."""

    def __init__(self, seed: int, faults: float) -> None:
        self.random = Random(seed)  # noqa: S311 - no secrets
        self.faults = faults
        self.tasks: list[Any] = []
        self.computations: list[tuple[Future, Callable[[], Any]]] = []
        self.done: list[str] = []
        self.faulty: list[str] = []
        self.logged = 0
        node: Any = SimpleNamespace(spawn=self.spawn, log_fault=self.log_fault)
        background: Any = SimpleNamespace(run=self.compute)
        self.work = GroupWork(node, background)
        self.numbers = {'state': 0, 'request': 0}

    def spawn(self, function: Any, *arguments: Any) -> None:
        async def guarded() -> None:
            try:
                await function(*arguments)
            except TroubleError:
                self.logged += 1

        self.tasks.append(guarded())

    def log_fault(self, _where: str, _error: Exception) -> None:
        self.logged += 1

    async def compute(self, function: Callable[[], Any], *, is_long: bool = True) -> Any:
        if not is_long:
            return function()
        finished: Future = Future()
        self.computations.append((finished, function))
        return await finished

    def note(self, name: str, *, is_faulty: bool) -> None:
        self.done.append(name)
        if is_faulty:
            self.faulty.append(name)
            raise TroubleError(name)

    def name(self, kind: str) -> str:
        self.numbers[kind] += 1
        return f'{kind} {self.numbers[kind]}'

    def receive_state(self) -> None:
        name, is_long = self.name('state'), self.random.random() < 0.3
        is_faulty = self.random.random() < self.faults

        def process() -> None:
            if is_long:
                self.work.start(lambda: self.note(name, is_faulty=is_faulty), lambda _: None)
            else:
                self.note(name, is_faulty=is_faulty)

        try:
            self.work.receive(process)
        except TroubleError:
            self.logged += 1

    def send_request(self) -> None:
        name, is_long = self.name('request'), self.random.random() < 0.3
        is_faulty = self.random.random() < self.faults
        self.spawn(self.work.run, lambda: self.note(name, is_faulty=is_faulty), lambda: is_long)

    def step(self) -> None:
        chance = self.random.random()
        if chance < 0.3 and self.computations:
            self.finish_computation()
        elif chance < 0.5:
            self.receive_state()
        elif chance < 0.6:
            self.send_request()
        self.resume()

    def finish_computation(self) -> None:
        finished, function = self.computations.pop(0)
        try:
            finished.set_result(function())
        except TroubleError as error:
            finished.set_exception(error)

    def resume(self) -> None:
        for task in reversed(list(self.tasks)):
            try:
                task.send(None)
            except StopIteration:
                self.tasks.remove(task)

    def end(self) -> None:
        """Do all that waits, without new work."""
        for _ in range(1000):
            while self.computations:
                self.finish_computation()
            self.resume()


@pytest.mark.parametrize('faults', [0.0, 0.1])
def test_all_work_is_done_in_order(faults: float) -> None:
    for seed in range(100):
        work = Work(seed, faults)
        for _ in range(150):
            work.step()
            is_computing = bool(work.computations or work.tasks)
            assert is_computing or not (work.work.is_busy or work.work.waiting_states), seed
        work.end()
        assert not work.tasks
        assert not work.work.is_busy
        for kind, number in work.numbers.items():
            done = [name for name in work.done if name.startswith(kind)]
            assert done == [f'{kind} {each}' for each in range(1, number + 1)], seed
        assert work.logged == len(work.faulty)
