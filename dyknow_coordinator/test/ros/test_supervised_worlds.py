"""Supervisors with their standbys in random worlds: states that nobody makes or reads are noticed.

Topics fall silent and speak again, requests take time and fail, violations come late, engines die,
and the reasoning engine may read another topic.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from itertools import count
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, StreamConstraints
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    Grounding,
    KnownStream,
    KnownStreams,
)
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.state_specification import FormulaInputs
from dyknow_coordinator.ros.evaluation.state_stream import StateStream
from dyknow_coordinator.ros.evaluation.state_supervisor import StateSupervisor
from dyknow_stream_processing import Violation, ViolationKind

TICK_S = 0.05
END_S = 40.0
SILENCE_S = 0.4
"""The time without a message after which a stream of states is violated."""

ABSENCE_S = 2.5
"""The time without a publisher after which the engine of a stream is lost."""

NOTICED_S = 6.0
"""The time within which it is noticed that nobody makes the states in use."""

UNREAD_S = 14.0
"""The time within which it is noticed that nobody reads them; reports take seconds."""

FEATURE = 'Power[uav1]'
SOURCES = tuple(
    FeatureSource(FEATURE, f'p_{each}', f'stream p_{each} = select x as "{FEATURE}" from "/{each}"')
    for each in 'abc'
)


class World:
    """A supervisor, and a simple model of all nodes that it calls."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)  # noqa: S311 - no secrets
        self.now_s = 100.0
        self.tasks: list[Any] = []
        self.waits: list[tuple[float, Future]] = []
        self.log: list[str] = []
        # Requests and messages under way, in order for each kind.
        self.pipes: dict[str, deque[tuple[float, Callable[[], None]]]] = {}
        self.made: dict[str, str] = {}
        self.violated: set[str] = set()
        self.heard: dict[str, float] = dict.fromkeys('abc', self.now_s)
        self.silent: set[str] = set()
        self.listeners: dict[str, StateStream] = {}
        self.read = '/states_1'
        self.kept = ''
        self.phase = EvaluationPhase.GROUNDING
        self.failure: DyKnowError | None = None
        self.slowness = self.random.choice([0.05, 0.3, 1.0])
        self.failures = self.random.choice([0.0, 0.0, 0.1])
        self.losses = self.random.choice([0.0, 0.01])
        self.absences: dict[str, float] = {}
        self.derailments = self.random.choice([0.0, 0.002])
        self.samples: Counter[str] = Counter()
        self.latest, self.is_derailed = 0, False
        self.deaths = self.random.choice([0.0, 0.005])
        clients = SimpleNamespace(
            create_stream=self.create_stream,
            evaluate_group=self.evaluate_group,
            keep_states=self.keep_states,
        )
        node = SimpleNamespace(
            now=lambda: round(self.now_s * SECOND_NS),
            spawn=lambda function, *arguments: self.tasks.append(function(*arguments)),
            deadlines=SimpleNamespace(after=self.after),
            get_logger=lambda: SimpleNamespace(info=self.log.append, warning=self.log.append),
            destroy_subscription=lambda _: None,
            resolve_service_name=lambda name: name,
            get_subscriptions_info_by_topic=self.readers,
        )
        self.context: Any = SimpleNamespace(
            node=node,
            clients=clients,
            streams=SimpleNamespace(
                known=KnownStreams([], lambda _: True), known_until=0, engines=('/engine',)
            ),
            cleanup=SimpleNamespace(keep_stream=lambda _: None, destroy_stream=self.destroy_stream),
            results=SimpleNamespace(topic='/results'),
            names=(f'states_{number}' for number in count(2)),
            state_topic=lambda name: f'/{name}',
            explained_wait=lambda text: text,
            wall_time=node.now,
            wall_time_s=lambda: self.now_s,
        )
        clients.stream_reasoning_engine = SimpleNamespace(name='/reasoner')
        self.report()
        inputs = FormulaInputs(
            (), Grounding.AUTO, (FEATURE,), Candidates(SOURCES), {}, StreamConstraints()
        )
        users: Any = SimpleNamespace(
            set_phase=self.set_phase,
            add_event=self.log.append,
            fail=self.fail,
            titles='formula',
            logger=SimpleNamespace(warning=lambda _: None),
        )
        self.supervisor = StateSupervisor(self.context, 7, 'states_1', inputs, users)
        self.tasks.append(self.start())

    async def start(self) -> None:
        try:
            await self.supervisor.start()
        except DyKnowError as error:
            self.fail(error)

    def set_phase(self, phase: EvaluationPhase) -> None:
        self.phase = phase

    def fail(self, error: DyKnowError) -> None:
        self.failure = self.failure or error

    def after(self, delay_s: float) -> Future:
        future: Future = Future()
        self.waits.append((self.now_s + delay_s, future))
        return future

    def send(self, kind: str, action: Callable[[], None]) -> None:
        """Do something later, after all that was sent before on the same way."""
        pipe = self.pipes.setdefault(kind, deque())
        due = self.now_s + self.random.expovariate(1 / self.slowness)
        pipe.append((max(due, pipe[-1][0] if pipe else due), action))

    async def request(self, kind: str, action: Callable[[], Any]) -> Any:
        answer: Future = Future()

        def serve() -> None:
            result = action()
            self.send(f'answers of {kind}', lambda: answer.set_result(result))

        self.send(kind, serve)
        result = await answer
        if self.random.random() < self.failures:
            raise CoordinationError('no answer', ExitCode.UNAVAILABLE)
        return result

    async def create_stream(self, name: str, text: str, *_: object) -> tuple[str, str]:
        (topic,) = (each for each in 'abc' if f'"/{each}"' in text)
        await self.request('creation', lambda: self.made.update({name: topic}))
        return f'/{name}', f'/{name}/violations'

    def destroy_stream(self, name: str) -> None:
        self.listeners.pop(name, None)
        self.send('destruction', lambda: self.made.pop(name, None))

    async def evaluate_group(self, _id: int, _domains: Any, topic: str, *_: Any, **__: Any) -> None:
        def evaluate() -> None:
            self.read = topic
            self.kept = '' if self.kept == topic else self.kept

        await self.request('groups', evaluate)

    async def keep_states(self, _id: int, topic: str) -> None:
        await self.request('groups', lambda: setattr(self, 'kept', topic))

    def readers(self, topic: str) -> list[Any]:
        is_read = topic in (self.read, self.kept)
        return [SimpleNamespace(node_namespace='/', node_name='reasoner')] * is_read

    def subscribe(self, stream: StateStream) -> None:
        self.listeners[stream.name] = stream
        stream._watch = SimpleNamespace(stop=lambda: None)  # type: ignore[assignment]

    def report(self) -> None:
        """Have the coordinator know the streams; later, as the report takes time."""

        def waits(topic: str) -> str:
            return 'silent' if self.now_s - self.heard[topic] > 3.0 else ''

        received = {each: round(at * SECOND_NS) for each, at in self.heard.items()}
        streams = [
            KnownStream(
                name,
                specification=f'select x from "/{topic}"',
                topic=f'/{name}',
                received={f'/{topic}': received[topic]},
                waits_for=waits(topic),
                samples=self.samples[name],
            )
            for name, topic in self.made.items()
        ]
        until = round(self.now_s * SECOND_NS)

        def take() -> None:
            self.context.streams.known = KnownStreams(streams, lambda _: True)
            self.context.streams.known_until = until

        if self.now_s > 100.0:
            self.send('reports', take)
        else:
            take()

    def tick(self) -> None:
        """Let some time pass."""
        self.now_s += TICK_S
        self.happen()
        self.make_states()
        self.watch()
        for pipe in list(self.pipes.values()):
            while pipe and pipe[0][0] <= self.now_s:
                pipe.popleft()[1]()
        due = [future for at, future in self.waits if at <= self.now_s]
        self.waits = [(at, future) for at, future in self.waits if at > self.now_s]
        for future in due:
            if not (future.done() or future.cancelled()):
                future.set_result(None)
        for _ in range(3):
            self.resume()

    def happen(self) -> None:
        """Change the world at random."""
        for topic in 'abc':
            if self.random.random() < (0.02 if topic in self.silent else 0.003):
                self.silent ^= {topic}
            if topic not in self.silent:
                self.heard[topic] = self.now_s
        if self.made and self.random.random() < self.deaths:
            del self.made[self.random.choice(sorted(self.made))]
        if self.random.random() < 0.2:
            self.report()
        if self.random.random() < 0.1:
            self.send('progress', partial(self.supervisor.note_progress, self.latest))
        if self.random.random() < self.derailments:
            self.read, self.is_derailed = '/nowhere', True
        if self.random.random() < 0.1:
            self.supervisor.look(round(2.5 * SECOND_NS))

    def make_states(self) -> None:
        for name, topic in self.made.items():
            self.samples[name] += topic not in self.silent
            if self.read == f'/{name}':
                self.latest = round(self.heard[topic] * SECOND_NS)
            is_broken = self.now_s - self.heard[topic] > SILENCE_S
            if is_broken and name not in self.violated:
                self.violate(name, topic, ViolationKind.MAX_DELAY)
            self.violated = self.violated | {name} if is_broken else self.violated - {name}
            if self.random.random() < self.losses:
                self.violate(name, topic, ViolationKind.LOST)

    def resume(self) -> None:
        """Resume all coroutines once."""
        self.random.shuffle(self.tasks)
        for task in list(self.tasks):
            try:
                task.send(None)
            except StopIteration:
                self.tasks.remove(task)

    def violate(self, name: str, topic: str, kind: ViolationKind) -> None:
        now = round(self.now_s * SECOND_NS)
        violation = Violation(f'/{topic}', kind, now, now, 0, 0, f'{name} is broken')

        def deliver() -> None:
            if (stream := self.listeners.get(name)) is not None:
                self.supervisor._on_violation(stream, violation)

        self.send('violations', deliver)

    def watch(self) -> None:
        """Tell of the streams that have had no publisher for a while, once each."""
        for name, stream in list(self.listeners.items()):
            self.absences[name] = 0.0 if name in self.made else self.absences.get(name, 0) + TICK_S
            if ABSENCE_S <= self.absences[name] < ABSENCE_S + TICK_S:
                self.supervisor._on_engine_lost(stream)

    @property
    def fault(self) -> str:
        """Why states may be missing."""
        stream, left = self.supervisor.stream, self.supervisor._left
        if stream._is_destroyed:
            return f'{stream.name} is destroyed'
        if stream.name not in self.made:
            return f'{stream.name} is not made'
        # It is read until the next one has caught up.
        is_read = self.read in (stream.topic, *(each.topic for each in left))
        return '' if is_read else f'{self.read} is read, not {stream.topic}'


def check(world: World) -> None:
    """Run a world; no fault may last while the phase is RUNNING."""
    since: dict[str, float] = {}
    while world.now_s < 100.0 + END_S and world.failure is None:
        world.tick()
        fault = world.fault if world.phase is EvaluationPhase.RUNNING else ''
        since = {fault: since.get(fault, world.now_s)} if fault else {}
        limit = UNREAD_S if 'is read' in fault else NOTICED_S
        assert world.now_s - since.get(fault, world.now_s) < limit, (fault, world.log[-12:])
        assert world.is_derailed or 'although states are made' not in ''.join(world.log)
    if world.failure is None:
        world.supervisor.end()
        while world.now_s < 160.0 + END_S and (world.tasks or world.made):
            world.tick()
        assert not world.tasks
        assert not world.made


@pytest.mark.parametrize('seed', range(40))
def test_states_that_nobody_makes_or_reads_are_noticed(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    world = World(seed)
    monkeypatch.setattr(StateStream, '_subscribe', lambda stream, _: world.subscribe(stream))
    check(world)
