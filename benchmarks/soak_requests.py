"""Clients of a soak, which send random requests, and the judgement of all answers."""

from __future__ import annotations

import random
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import (
    ConceptGetInstances,
    FindAllMatchingStreams,
    FormulaGroupDestroy,
    ListSemanticSpecifications,
    ListStreams,
)
from processes import ENGINE, MANAGER, percentile
from rclpy.action import ActionClient
from rclpy.task import Future
from running_system import AT_ONCE, COORDINATOR, REASONER, RunningSystem, outcome_of

from dyknow_common import SECOND_NS
from dyknow_common.ros import SERVICE, nanoseconds_to_duration, time_to_nanoseconds

Levels = Mapping[str, Sequence[int]]
"""The stamps of the high levels of each vehicle."""

MAX_DELAY_S = 10.0
"""Maximum time from the timeout of a request to its answer: it takes some seconds to notice an
engine that is stopped for long, and to ask another one."""

MAX_OPEN = 12
TIMED_PERIOD_S = 0.5
"""Time between two requests that are timed. They are sent also while earlier ones wait."""

DISCOVERY_S = 1.0
"""Time for the nodes to discover the clients, too."""

WINDOW_S = 2
"""Length of the windows in formulas."""

MARGIN_NS = SECOND_NS // 4
"""Time at both ends of a window that is ignored: five states."""

MAX_AGE_NS = SECOND_NS
"""Maximum age of a value: a silent stream violates its constraints."""

SLACK_S = 5.0
"""Time between a high level and the timeout of a formula that leaves enough for its verdict."""

FAILURES = frozenset({ExitStatus.UNAVAILABLE, ExitStatus.CONSTRAINT_VIOLATION, ExitStatus.TIMEOUT})
"""Errors that any request may get while nodes and topics fail."""

DEFECTS = ('wrong', 'lost', 'late', 'failed')
"""Kinds of defects of answers: a wrong one, none, one too late, an error that is not due."""

_LIMIT = re.compile(r'\bat most \d|\blimit\b')
_TRUE = frozenset({FormulaResult.TRUE})
_FALSE = frozenset({FormulaResult.FALSE})
_HELD = 'always[0 s, {window} s] Power[{{}}] < {most}'.format


@dataclass(frozen=True)
class Kind:
    """A kind of formula.

    Args:
        text: with a placeholder for a vehicle.
        verdicts: the correct ones.
        error: the one without a verdict, where nothing fails.
        timeout: seconds.
        watches: True if its verdict depends on high levels.
        cancelled_after: seconds after which a monitored formula is cancelled; None: not monitored.
    """

    text: str
    verdicts: frozenset[int] = frozenset()
    error: int | None = None
    timeout: float = 10.0
    watches: bool = False
    cancelled_after: float | None = None


TIMED = 'true at once'
KINDS = {
    TIMED: Kind(AT_ONCE, _TRUE),
    'true soon': Kind(_HELD(window=WINDOW_S, most=1000), _TRUE),
    'false soon': Kind(f'eventually[0 s, {WINDOW_S} s] Power[{{}}] > 1000', _FALSE),
    'held': Kind(_HELD(window=WINDOW_S, most=100), _TRUE | _FALSE, watches=True),
    'held for ever': Kind('always Power[{}] < 100', _FALSE, watches=True),
    'held by all': Kind('forall u in UAV: always Power[u] < 100', _FALSE, None, 20.0, watches=True),
    'timeout': Kind('always Power[{}] < 1000', error=ExitStatus.TIMEOUT, timeout=1.0),
    'cancelled': Kind('always Power[{}] < 1000', error=ExitStatus.CANCELLED, cancelled_after=1.5),
    'monitored': Kind(_HELD(window=WINDOW_S, most=1000), _TRUE, cancelled_after=30.0),
    'bad syntax': Kind('always Power[{}] <', error=ExitStatus.INVALID_ARGUMENT),
    'bad type': Kind('Power[{}] and true', error=ExitStatus.INVALID_ARGUMENT),
    'unknown feature': Kind('always Powr[{}] < 100', error=ExitStatus.NOT_FOUND),
    'unknown object': Kind('always Power[nobody] < 100', error=ExitStatus.NOT_FOUND),
}
LONGEST_S = max(kind.timeout for kind in KINDS.values()) + MAX_DELAY_S
"""The time within which each request must have its answer."""

LOOKS: dict[str, tuple[Any, dict[str, Any], Callable[[Any, RunningSystem], bool]]] = {
    f'{MANAGER}/list_streams': (ListStreams, {}, lambda found, system: system.fleet_streams
                                <= set(found.stream_names)),
    f'{ENGINE}/list_streams': (ListStreams, {}, lambda found, system: system.fleet_streams
                               <= set(found.stream_names)),
    'ontology_manager/concept_get_instances': (
        ConceptGetInstances, {'concept_name': 'UAV'},
        lambda found, system: set(found.instances) == set(system.sources)),
    'stream_semantics_manager/list_semantic_specifications': (
        ListSemanticSpecifications, {},
        lambda found, system: len(found.ssl_statements) >= len(system.fleet_streams)),
    'semantic_matching_engine/find_all_matching_streams': (
        FindAllMatchingStreams, {'concept': 'Power'},
        lambda found, system: len(found.stream_specifications) >= len(system.fleet_streams)),
    f'{REASONER}/formula_group_destroy': (
        FormulaGroupDestroy, {'formula_group_id': -1},
        lambda found, _: found.exit_status.code == ExitStatus.NOT_FOUND),
}  # fmt: skip
"""Requests to each node, and when their answers are right."""


@dataclass
class Request:
    """A formula or a look at a node, and its answer; times of the monotonic clock, seconds.

    Args:
        name: of its kind, or of the service.
        vehicles: that the formula is about.
    """

    name: str
    vehicles: Sequence[str] = ()
    begun: float = field(default_factory=time.monotonic)
    ended: float | None = None
    answer: Any = None

    def end(self, answer: Any) -> None:
        """Note the answer."""
        self.answer, self.ended = answer, time.monotonic()

    def defect(self, system: RunningSystem, high: Levels, *, may_fail: bool) -> tuple[str, str]:
        """Return the kind of the defect of the answer, and the defect; empty if there is none.

        Args:
            system: that was asked.
            high: the high levels.
            may_fail: True if nodes and topics fail.
        """
        if self.ended is None:
            return 'lost', 'no answer'
        if self.name in LOOKS:
            is_right = LOOKS[self.name][2](self.answer, system)
            return ('', '') if is_right else ('wrong', str(self.answer)[:300])
        if self.ended - self.begun > KINDS[self.name].timeout + MAX_DELAY_S:
            return 'late', f'answered after {self.ended - self.begun:.1f} s'
        if self.answer.exit_status.code:
            return self._defect_of_error(high, may_fail=may_fail)
        fault = self._wrong_verdict(high)
        return ('wrong', fault) if fault else ('', '')

    def _defect_of_error(self, high: Levels, *, may_fail: bool) -> tuple[str, str]:
        status, kind = self.answer.exit_status, KINDS[self.name]
        due = ExitStatus.TIMEOUT if self._holds_for_ever(high) else kind.error
        if status.code == due or (may_fail and status.code in FAILURES):
            return '', ''
        if status.code == ExitStatus.UNAVAILABLE and _LIMIT.search(status.message):
            return 'refused', status.message[:300]
        return 'failed', f'error {status.code}: {status.message[:300]}'

    def _holds_for_ever(self, high: Levels) -> bool:
        """Return True if no high level decides a formula that has no other verdict than false."""
        kind = KINDS[self.name]
        if not kind.watches or FormulaResult.TRUE in kind.verdicts:
            return False
        begun = time.time_ns() - round((time.monotonic() - self.begun) * 1e9)
        first = begun + 2 * SECOND_NS
        last = begun + round((kind.timeout - SLACK_S) * 1e9)
        return not any(first <= stamp <= last for stamp in self._stamps(high))

    def _wrong_verdict(self, high: Levels) -> str:
        """Return how the verdict is wrong; empty if it is right."""
        kind, verdict = KINDS[self.name], self.answer.verdict
        if verdict not in kind.verdicts:
            return f'verdict {verdict}'
        if not kind.watches:
            return ''
        decided, stamps = time_to_nanoseconds(self.answer.decided_at), self._stamps(high)
        if verdict == FormulaResult.FALSE:
            seen = any(decided - MAX_AGE_NS <= stamp <= decided for stamp in stamps)
            return '' if seen else 'false, and no level was high'
        begun = decided - WINDOW_S * SECOND_NS + MARGIN_NS
        missed = [stamp for stamp in stamps if begun <= stamp <= decided - MARGIN_NS]
        return f'true, and {len(missed)} levels were high' if missed else ''

    def _stamps(self, high: Levels) -> list[int]:
        return [stamp for vehicle in self.vehicles for stamp in high.get(vehicle, ())]


class Clients:
    """Clients that send random formulas, and look at each node.

    Args:
        system: that they ask.
        chance: of what they ask.
        period_s: the time between two random formulas.
        may_fail: True if nodes and topics fail; then nobody looks at the nodes.
    """

    def __init__(
        self, system: RunningSystem, chance: random.Random, period_s: float, *, may_fail: bool
    ) -> None:
        self.requests: list[Request] = []
        self._system = system
        self._chance = chance
        self._period_s = period_s
        self._may_fail = may_fail
        self._next = self._next_timed = 0.0
        # Answers to others fill the ten places of the default profile, too.
        profiles = dict.fromkeys(
            (f'{each}_service_qos_profile' for each in ('goal', 'result', 'cancel')), SERVICE
        )
        client = system.client
        self._monitor = ActionClient(
            client.node, MonitorFormula, f'{COORDINATOR}/monitor_formula', **profiles
        )
        looks = {
            name: client.node.create_client(kind, name, qos_profile=SERVICE)
            for name, (kind, *_) in LOOKS.items()
        }
        client.spin_until(
            lambda: (
                self._monitor.server_is_ready()
                and all(each.service_is_ready() for each in looks.values())
            ),
            'all services',
        )
        self._looks = {} if may_fail else looks
        client.wait(DISCOVERY_S)

    @property
    def is_answered(self) -> bool:
        """True if every request has its answer."""
        return all(each.ended is not None for each in self.requests)

    def step(self) -> None:
        """Send the requests that are due."""
        now = time.monotonic()
        # A coordinator that has died is not waited for; the soak starts it again.
        with suppress(AssertionError):
            if now >= self._next:
                self._next = now + self._period_s
                if sum(each.ended is None for each in self.requests) < MAX_OPEN:
                    self._ask(self._chance.choice(list(KINDS)))
            if now >= self._next_timed:
                self._next_timed = now + TIMED_PERIOD_S
                self._ask(TIMED)
                if self._looks:
                    self._look(self._chance.choice(list(self._looks)))

    def report(self, high: Levels) -> dict[str, Any]:
        """Return the outcomes, the latencies and the defects of all answers."""
        defects: defaultdict[str, list[str]] = defaultdict(list)
        latencies: defaultdict[str, list[float]] = defaultdict(list)
        outcomes: Counter[str] = Counter()
        for each in self.requests:
            kind, text = each.defect(self._system, high, may_fail=self._may_fail)
            if kind:
                defects[kind].append(f'{each.name}: {text}')
            if each.name == TIMED or each.name in LOOKS:
                latencies[each.name].append((each.ended or time.monotonic()) - each.begun)
            if each.name not in LOOKS:
                outcomes[f'{each.name}: {outcome_of(each.answer)}'] += 1
        return {
            'asked': len(self.requests),
            'outcomes': dict(sorted(outcomes.items())),
            **{kind: defects[kind] for kind in (*DEFECTS, 'refused')},
            'latency_ms': {name: _summary(found) for name, found in sorted(latencies.items())},
        }

    def _ask(self, name: str) -> None:
        kind = KINDS[name]
        vehicle = self._chance.choice(list(self._system.sources))
        text = kind.text.format(vehicle)
        asked = Request(name, [vehicle] if '{}' in kind.text else list(self._system.sources))
        self.requests.append(asked)
        if kind.cancelled_after is None:
            future = self._system.ask(text, kind.timeout)
            future.add_done_callback(lambda done: asked.end(done.result()))
        else:
            self._watch(text, kind, asked)

    def _watch(self, text: str, kind: Kind, asked: Request) -> None:
        node = self._system.client.node
        timeout = nanoseconds_to_duration(round(kind.timeout * 1e9))

        def accepted(done: Future) -> None:
            handle = done.result()

            def cancel() -> None:
                node.destroy_timer(timer)
                if asked.ended is None:
                    handle.cancel_goal_async()

            timer = node.create_timer(kind.cancelled_after, cancel)
            ended = handle.get_result_async()
            ended.add_done_callback(lambda found: asked.end(found.result().result))

        goal = MonitorFormula.Goal(formula=text, timeout=timeout)
        self._monitor.send_goal_async(goal).add_done_callback(accepted)

    def _look(self, name: str) -> None:
        kind, fields, _ = LOOKS[name]
        asked = Request(name)
        self.requests.append(asked)
        future = self._looks[name].call_async(kind.Request(**fields))
        future.add_done_callback(lambda done: asked.end(done.result()))


def _summary(seconds: Sequence[float]) -> dict[str, float]:
    """Return the median, the 99th percentile and the most of latencies, milliseconds."""
    places = {'median': 50, 'p99': 99, 'max': 100}
    found = {name: round(percentile(seconds, each) * 1e3, 1) for name, each in places.items()}
    return {**found, 'count': len(seconds)}
