"""A formula in the running system, in simulated time and without middleware.

The coordinator's supervision of states and the reasoning engine's evaluation of a group run as they
are. `RecordedStreams` stands for the stream manager, the processing engine and the topics. What the
nodes send each other takes as long as a test says: requests and replies overtake those of other
services, but states and violations reach a node in order, as from one publisher.

    10.00 s   a message of /a completes a state; the reasoning engine receives it 30 ms later
    10.31 s   /a breaks max_gap: the coordinator hears of it at 10.32 s, the engine at 10.35 s
    10.32 s   the coordinator requests another state stream, which is made at 10.40 s
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import count
from types import SimpleNamespace
from typing import Any, Final
from unittest import mock

from dyknow_interfaces.msg import ConstraintViolation
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Verdict
from dyknow_common.ros import (
    nanoseconds_to_duration,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_coordinator import EvaluationPhase, KnownStream, KnownStreams
from dyknow_coordinator.ros.evaluation import silence_monitor, standby, state_stream
from dyknow_coordinator.ros.evaluation.silence_monitor import SilenceMonitor
from dyknow_coordinator.ros.evaluation.state_supervisor import StateSupervisor
from dyknow_reasoning import FormulaGroup, UnknownFeatures
from dyknow_reasoning.ros import group_evaluation, state_subscription
from dyknow_reasoning.ros.group_evaluation import GroupEvaluation
from dyknow_reasoning.ros.stream_reasoning_engine import SUPERVISION_PERIOD_S
from dyknow_recordings.evaluation.grounding import FormulaGrounder
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.evaluation.vocabulary import Vocabulary
from dyknow_recordings.reading.recording import RecordingReader, batches, rows_of
from dyknow_stream_processing import Sample, Violation

Delay = Callable[[str], int]
"""Returns how long something takes, in nanoseconds, given what it is."""

GROUP: Final = 7
REPORT_PERIOD_NS: Final = SECOND_NS
SILENT_NS: Final = 3 * SECOND_NS


class Simulation:
    """A clock, and what happens by it; coroutines run on whenever something has happened."""

    def __init__(self, now: int) -> None:
        self.now = now
        self._heap: list[tuple[int, int, Callable[[], None]]] = []
        self._number = count()
        self._tasks: list[Coroutine[Any, Any, None]] = []
        self._spawned = 0
        self._reached: dict[object, int] = {}

    def at(self, time: int, happen: Callable[[], None]) -> None:
        """Have something happen at a time, after all else that happens then."""
        heapq.heappush(self._heap, (max(time, self.now), next(self._number), happen))

    def in_order(self, channel: object, delay: int, happen: Callable[[], None]) -> None:
        """Have something happen after a delay, and after what was sent on its channel before."""
        self._reached[channel] = max(self._reached.get(channel, 0), self.now + delay)
        self.at(self._reached[channel], happen)

    def spawn(self, function: Callable[..., Coroutine[Any, Any, None]], *arguments: Any) -> None:
        """Run a coroutine as soon as what happens now has happened."""
        self._tasks.append(function(*arguments))
        self._spawned += 1

    def after(self, seconds: float) -> Future:
        """Return a future that is done after some time."""
        future: Future = Future()
        self.at(
            self.now + round(seconds * SECOND_NS),
            lambda: future.set_result(None) if open_() else None,
        )

        def open_() -> bool:
            return not (future.done() or future.cancelled())

        return future

    def next_time(self) -> int | None:
        """Return when something happens next; None if nothing does."""
        return self._heap[0][0] if self._heap else None

    def happen(self) -> None:
        """Let the next thing happen."""
        self.now, _, happen = heapq.heappop(self._heap)
        happen()
        self.settle()

    def settle(self) -> None:
        """Run all coroutines until each waits for something to happen."""
        quiet = 0
        while self._tasks and quiet < 2:
            before = len(self._heap), len(self._tasks), self._spawned
            tasks, self._tasks = self._tasks, []
            self._tasks = [each for each in tasks if not _steps_to_end(each)] + self._tasks
            after = len(self._heap), len(self._tasks), self._spawned
            quiet = quiet + 1 if after == before else 0

    def close(self) -> None:
        """End all coroutines."""
        for each in self._tasks:
            each.close()


def _steps_to_end(task: Coroutine[Any, Any, None]) -> bool:
    try:
        task.send(None)
    except StopIteration:
        return True
    return False


@dataclass
class Outcome:
    """The result of a formula, and what its client was told meanwhile."""

    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    error: DyKnowError | None = None
    events: list[str] = field(default_factory=list)
    phases: list[EvaluationPhase] = field(default_factory=list)
    has_ended: bool = False


class _Node:
    """A node, as far as the supervision of states and the evaluation of groups use it."""

    def __init__(self, system: SimulatedSystem, name: str) -> None:
        self._system, self._simulation = system, system.simulation
        self.name = name
        self.reentrant = None
        self.heartbeats = mock.MagicMock()
        self.deadlines = SimpleNamespace(after=self._simulation.after)
        self.spawn = self._simulation.spawn
        self.wall_clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now()))
        self.context = SimpleNamespace(ok=lambda: True)
        stamp = SimpleNamespace(now=lambda: SimpleNamespace(to_msg=self._stamp))
        self.get_clock = lambda: stamp
        self.get_logger = mock.MagicMock()

    def now(self) -> int:
        return self._simulation.now

    def _stamp(self) -> Any:
        return nanoseconds_to_time(self._simulation.now)

    @staticmethod
    def resolve_topic_name(topic: str) -> str:
        return topic if topic.startswith('/') else f'/{topic}'

    resolve_service_name = resolve_topic_name

    def create_timer(self, period_s: float, callback: Callable[[], None], **_: object) -> None:
        def ring() -> None:
            callback()
            self._simulation.at(self._simulation.now + round(period_s * SECOND_NS), ring)

        self._simulation.at(self._simulation.now + round(period_s * SECOND_NS), ring)

    def create_subscription(
        self, _type: type, topic: str, callback: Callable[[Any], None], *_: object, **__: object
    ) -> _Subscription:
        return _Subscription(self, None, topic, lambda message, _: callback(message))

    def destroy_subscription(self, subscription: _Subscription | None) -> None:
        if subscription is not None:
            subscription.destroy()

    def get_subscriptions_info_by_topic(self, topic: str) -> Sequence[Any]:
        found = [each for each in self._system.subscriptions if each.topic == topic]
        return [SimpleNamespace(node_namespace='/', node_name=each.node.name) for each in found]


class _Subscription:
    """A subscription to a topic of the system."""

    def __init__(
        self,
        node: _Node,
        _type: object,
        topic: str,
        callback: Callable[[Any, Any], None],
        *_: object,
        **__: object,
    ) -> None:
        self.node, self.topic, self._callback = node, topic, callback
        self._system = node._system
        self._system.subscriptions.append(self)
        for message in self._system.latched[topic]:
            self.send(message)

    def send(self, message: Any) -> None:
        """Deliver a message later."""
        stream = self.topic.removesuffix('/violations')
        delay = self._system.delay('message')
        channel = self.node.name, stream
        self._system.simulation.in_order(channel, delay, lambda: self._receive(message))

    def _receive(self, message: Any) -> None:
        if self in self._system.subscriptions:
            self._callback(message, {})

    def retry(self) -> None:
        """There is nothing to retry: all publishers are known."""

    def destroy(self) -> None:
        if self in self._system.subscriptions:
            self._system.subscriptions.remove(self)


class _Clients:
    """The services that the coordinator calls."""

    def __init__(self, system: SimulatedSystem) -> None:
        self._system = system
        self.stream_reasoning_engine = SimpleNamespace(name='reasoning_engine', alive=True)

    async def evaluate_group(
        self,
        _group_id: int,
        domains: Any,
        topic: str,
        result_topic: str,
        *,
        gap: bool = False,
        doubtful_from: int = 0,
    ) -> None:
        group = self._system.group

        async def evaluate() -> None:
            if group.has_begun:
                await group.change_stream(
                    domains, topic, result_topic, gap=gap, doubtful_from=doubtful_from
                )
            else:
                unknown = UnknownFeatures(self._system.inputs.unknown)
                await group.begin(domains, topic, result_topic, unknown)

        await self._system.call('evaluate', evaluate)

    async def keep_states(self, _group_id: int, topic: str) -> None:
        async def keep() -> None:
            await self._system.group.set_standby(topic)

        await self._system.call('keep', keep)

    async def create_stream(
        self, name: str, specification: str, constraints: Any, _sources: object
    ) -> tuple[str, str]:
        async def create() -> None:
            self._system.create(name, specification, constraints)

        await self._system.call('streams', create)
        return _topic(name), f'{_topic(name)}/violations'


def _topic(name: str) -> str:
    return f'/dyknow/streams/{name}'


class SimulatedSystem:
    """The nodes that evaluate a formula over the messages of a recording.

    Args:
        recording: its messages are published at their log times.
        formula: its text.
        vocabulary: finds its streams.
        delay: of what the nodes send each other; None: everything comes at once.
        silence_limit_s: the parameter of the coordinator.
    """

    def __init__(
        self,
        recording: RecordingReader,
        formula: str,
        vocabulary: Vocabulary,
        delay: Delay | None = None,
        silence_limit_s: float = 5.0,
    ) -> None:
        self._silence_limit_s = silence_limit_s
        self.recording = recording
        self.outcome = Outcome()
        self.simulation = Simulation(recording.start_time)
        self.is_instant, self.delay = delay is None, delay or (lambda _: 0)
        self.subscriptions: list[_Subscription] = []
        self.latched: defaultdict[str, list[Any]] = defaultdict(list)
        self.streams = RecordedStreams(recording.contents, ())
        self._made: dict[str, tuple[str, int]] = {}
        self._samples: dict[str, int] = {}
        grounded = FormulaGrounder(vocabulary, self.streams).ground(formula)
        self.inputs = grounded.inputs
        self._fields = self.streams.prepare(self.inputs.candidates.found)
        self._report = KnownStreams([], lambda _: False)
        self._reported_until = self._heard_at = 0
        node = _Node(self, 'coordinator')
        self._engine = _Node(self, 'reasoning_engine')
        formulas = FormulaGroup()
        formulas.add_formula(grounded.formula, grounded.formula)
        background = SimpleNamespace(run=_at_once)
        publisher: Any = mock.MagicMock()
        self.group = GroupEvaluation(
            self._engine,
            GROUP,
            'group',
            formulas,
            background,  # type: ignore[arg-type]
            publisher,
            publisher,
        )
        self._engine.create_timer(SUPERVISION_PERIOD_S, self.group.change_if_due)
        self._context: Any = SimpleNamespace(
            node=node,
            clients=_Clients(self),
            streams=_Mirror(self),
            results=SimpleNamespace(topic='/results'),
            explained_wait=str,
            cleanup=SimpleNamespace(keep_stream=lambda _: None, destroy_stream=self._destroy_soon),
            names=(f'states_{number}' for number in count(2)),
            wall_time=node.now,
            wall_time_s=lambda: node.now() / SECOND_NS,
            state_topic=_topic,
        )

    def run(self) -> Outcome:
        """Publish all messages, and return the result at the end of the recording."""
        with _without_middleware():
            self._start()
            for batch in batches(self.recording.columns(self._fields)):
                for message in rows_of(batch):
                    self._run_until(message.log_time)
                    if self.outcome.has_ended:
                        break
                    self.streams.push(message)
                    self.simulation.settle()
            end = self.recording.end_time
            self._run_until(end + 1)
            self._run_until(end + SECOND_NS, dataflow=False)
        self.simulation.close()
        return self.outcome

    def _start(self) -> None:
        self._supervisor = StateSupervisor(
            self._context,
            GROUP,
            'states_1',
            self.inputs,
            _Observer(self),  # type: ignore[arg-type]
        )
        group: Any = SimpleNamespace(
            states=self._supervisor, titles='it', waits_for='', set_waiting=lambda _: None
        )
        groups: Any = SimpleNamespace(running=lambda: [] if self.outcome.has_ended else [group])
        SilenceMonitor(self._context, groups, lambda: self._silence_limit_s)
        self._publish_report()
        self.simulation.spawn(self._begin)

    async def _begin(self) -> None:
        clients, inputs = self._context.clients, self.inputs
        try:
            await clients.evaluate_group(GROUP, inputs.domains, _topic('states_1'), '/results')
            await self._supervisor.start()
        except DyKnowError as error:
            self.fail(error)

    def _run_until(self, end: int, *, dataflow: bool = True) -> None:
        """Let everything happen that is due before a time, and the dataflow's work until then."""
        while True:
            due = self.streams.dataflow.next_deadline() if dataflow else None
            then = self.simulation.next_time()
            if due is not None and due <= end and (then is None or due <= then):
                self.simulation.now = max(due, self.simulation.now)
                self.streams.dataflow.advance(due)
                self.simulation.settle()
            elif then is not None and then <= end:
                self.simulation.happen()
            else:
                break
        self.simulation.now = max(end, self.simulation.now)

    async def call(self, service: str, handle: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Call a service: requests arrive in order, replies in any."""
        reply: Future = Future()

        async def serve() -> None:
            error: DyKnowError | None = None
            try:
                await handle()
            except DyKnowError as raised:
                error = raised
            later = self.simulation.now + self.delay('reply')
            self.simulation.at(later, lambda: reply.set_result(error))

        self.simulation.in_order(
            service, self.delay('request'), lambda: self.simulation.spawn(serve)
        )
        error = await reply
        if error is not None:
            raise error

    def create(self, name: str, specification: str, constraints: Any) -> None:
        """Make a stream, whose samples and violations are published."""
        topic = _topic(name)

        def publish(sample: Sample) -> None:
            self._samples[name] = self.simulation.now
            self._send(topic, sample)

        def report(violation: Violation) -> None:
            message = _message(violation, self.simulation.now)
            self.latched[f'{topic}/violations'].append(message)
            self._send(f'{topic}/violations', message)

        self.streams.create(name, specification, constraints, publish, report)
        self._made[name] = specification, self.simulation.now
        self._publish_soon()

    def _destroy_soon(self, name: str) -> None:
        async def destroy() -> None:
            if self._made.pop(name, None):
                self.streams.destroy(name)
                self._publish_soon()

        self.simulation.spawn(self.call, 'streams', destroy)

    def _send(self, topic: str, message: Any) -> None:
        for each in [each for each in self.subscriptions if each.topic == topic]:
            each.send(message)

    def known(self) -> KnownStreams:
        """Return the streams as the stream manager knows them; as reported, if that takes time."""
        return self._present() if self.is_instant else self._report

    @property
    def known_until(self) -> int:
        """The time until which the messages of all topics are known."""
        return self.simulation.now if self.is_instant else self._reported_until

    @property
    def heard_at(self) -> int:
        """The time of the latest report."""
        return self.simulation.now if self.is_instant else self._heard_at

    def _present(self) -> KnownStreams:
        streams = self.streams
        made = [
            KnownStream(
                name,
                specification,
                _topic(name),
                stream_id=1,
                received=streams.received(name),
                waits_for=self._waits_for(name, created_at),
            )
            for name, (specification, created_at) in self._made.items()
        ]
        topics = {each.topic for each in made}
        # Nobody knows of a topic that no stream is made from whether it has had a message.
        begun = (lambda topic: streams.received_at(topic) > 0) if self.is_instant else None
        found = {each for each in self.recording.contents if streams.is_published(each)}
        return KnownStreams(made, (topics | found).__contains__, streams.absolute, begun)

    def _waits_for(self, name: str, created_at: int) -> str:
        latest = self._samples.get(name)
        if latest is not None and self.simulation.now - latest < SILENT_NS:
            return ''
        return self.streams.waits_for(name, created_at) or 'samples'

    def _publish_report(self) -> None:
        self._publish_soon()
        self.simulation.at(self.simulation.now + REPORT_PERIOD_NS, self._publish_report)

    def _publish_soon(self) -> None:
        report, until = self._present(), self.simulation.now
        self.simulation.in_order('reports', self.delay('report'), lambda: self._hear(report, until))

    def _hear(self, report: KnownStreams, until: int) -> None:
        before, self._report = self._report.published(), report
        self._reported_until, self._heard_at = until, self.simulation.now
        if report.published() != before and not self.outcome.has_ended:
            self._supervisor.improve()

    def receive_result(self, result: Any) -> None:
        """Receive a FormulaResult at the coordinator."""
        if result.exit_status.code != ExitCode.SUCCESS:
            self.fail(DyKnowError(result.exit_status.message, ExitCode(result.exit_status.code)))
        elif not self.outcome.has_ended:
            self.outcome.verdict = Verdict(result.verdict)
            self.outcome.decided_at = time_to_nanoseconds(result.decided_at)
            self._end()

    def fail(self, error: DyKnowError) -> None:
        """End with an error, unless there is a result."""
        if not self.outcome.has_ended:
            self.outcome.error = error
            self._end()

    def _end(self) -> None:
        self.outcome.has_ended = True
        self._supervisor.end()
        self.group.destroy()


class _Observer:
    """The formula's evaluation at the coordinator."""

    titles, logger = 'it', mock.MagicMock()

    def __init__(self, system: SimulatedSystem) -> None:
        self._outcome = system.outcome
        self.fail = system.fail

    def set_phase(self, phase: EvaluationPhase) -> None:
        self._outcome.phases.append(phase)

    def add_event(self, event: str) -> None:
        if not self._outcome.has_ended:
            self._outcome.events.append(event)


class _Mirror:
    """The reports of the stream manager, at the coordinator."""

    def __init__(self, system: SimulatedSystem) -> None:
        self._system = system

    @property
    def known(self) -> KnownStreams:
        return self._system.known()

    @property
    def known_until(self) -> int:
        return self._system.known_until

    @property
    def heard_at(self) -> int:
        return self._system.heard_at


class _ResultPublisher:
    """The publisher of the results of the reasoning engine."""

    def __init__(self, node: _Node, *_: object) -> None:
        self._system = node._system

    def publish(self, message: Any) -> None:
        system = self._system
        delay = system.delay('message')
        system.simulation.in_order('results', delay, lambda: system.receive_result(message))

    @staticmethod
    def get_subscription_count() -> int:
        return 1

    def destroy(self) -> None:
        """Nothing is left."""


async def _at_once(function: Callable[[], Any], **_: object) -> Any:
    return function()


def _message(violation: Violation, now: int) -> ConstraintViolation:
    return ConstraintViolation(
        stream_name=violation.stream_name,
        constraint=str(violation.constraint),
        valid_time=nanoseconds_to_time(violation.valid_time),
        available_time=nanoseconds_to_time(max(violation.available_time, now)),
        observed=nanoseconds_to_duration(violation.observed),
        allowed=nanoseconds_to_duration(violation.allowed),
        message=violation.message,
    )


@contextmanager
def _without_middleware() -> Iterator[None]:
    replaced = [
        (group_evaluation, 'DirectPublisher', _ResultPublisher),
        (state_subscription, 'DirectSubscription', _Subscription),
        (state_subscription, 'TopicOwner', mock.MagicMock()),
        (state_stream, 'PublisherWatch', mock.MagicMock()),
        (standby, 'LOOK_PERIOD_S', silence_monitor.PERIOD_S),
    ]
    with ExitStack() as stack:
        for module, name, value in replaced:
            stack.enter_context(mock.patch.object(module, name, value))
        yield
