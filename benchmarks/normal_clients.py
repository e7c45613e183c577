"""Normal clients, whose answers are timed and judged while others do harm."""

from __future__ import annotations

import random
import re
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import (
    ConceptGetInstances,
    FindAllMatchingStreams,
    FormulaGroupDestroy,
    ListSemanticSpecifications,
    ListStreams,
)
from processes import ENGINE, MANAGER, percentile
from random_requests import RandomRequests, Request
from running_system import REASONER, RunningSystem

from dyknow_common import SECOND_NS
from dyknow_common.ros import SERVICE

REQUEST_PERIOD_S = 0.2
PROBE_PERIOD_S = 0.5
"""Time between two requests that are timed. They are sent also while earlier ones wait."""

AT_ONCE = 'true at once'
"""The kind of formula that is timed: the first state decides it."""

DISCOVERY_S = 1.0
"""Time for the nodes to discover the clients, too."""

SLACK_S = 5.0
"""Time between a high level and the timeout of a formula that leaves enough for its verdict."""

DEFECTS = ('wrong', 'missing', 'lost', 'failed')
"""Kinds of defects of answers: a wrong or missing verdict, no answer, an error that is not due."""

_LIMIT = re.compile(r'\bat most \d|\blimit\b')
_LOOKS: tuple[tuple[Any, str, dict[str, Any], Callable[[Any, set[str], set[str]], bool]], ...] = (
    (ListStreams, f'{MANAGER}/list_streams', {}, lambda found, streams, _: streams
     <= set(found.stream_names)),
    (ListStreams, f'{ENGINE}/list_streams', {}, lambda found, streams, _: streams
     <= set(found.stream_names)),
    (ConceptGetInstances, 'ontology_manager/concept_get_instances', {'concept_name': 'UAV'},
     lambda found, _, vehicles: set(found.instances) == vehicles),
    (ListSemanticSpecifications, 'stream_semantics_manager/list_semantic_specifications', {},
     lambda found, streams, _: len(found.ssl_statements) >= len(streams)),
    (FindAllMatchingStreams, 'semantic_matching_engine/find_all_matching_streams',
     {'concept': 'Power'}, lambda found, streams, _: len(found.stream_specifications)
     >= len(streams)),
    (FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', {'formula_group_id': -1},
     lambda found, *_: found.exit_status.code == ExitStatus.NOT_FOUND),
)  # fmt: skip
"""Requests to each node, and whether an answer is right, given the streams and the vehicles."""


@dataclass
class _Look:
    """A request to a node, and its answer."""

    service: str
    begun: float
    ended: float | None = None
    fault: str = ''


@dataclass
class NormalClients:
    """Clients that send random formulas, and look at each node."""

    system: RunningSystem
    chance: random.Random
    _looks: list[_Look] = field(default_factory=list)
    _clients: dict[str, Any] = field(default_factory=dict)
    _next_request: float = 0.0
    _next_probe: float = 0.0

    def __post_init__(self) -> None:
        self.requests = RandomRequests(self.system.client, list(self.system.sources), self.chance)
        for kind, service, *_ in _LOOKS:
            self._clients[service] = self.system.client.node.create_client(
                kind, service, qos_profile=SERVICE
            )
        clients = self._clients.values()
        self.system.client.spin_until(
            lambda: all(each.service_is_ready() for each in clients), 'all services'
        )
        self.system.wait(DISCOVERY_S)

    def step(self) -> None:
        """Send the requests that are due."""
        now = time.monotonic()
        if now >= self._next_request:
            self._next_request = now + REQUEST_PERIOD_S
            # A coordinator that has died is not waited for; the soak starts it again.
            with suppress(AssertionError):
                self.requests.send()
        if now >= self._next_probe:
            self._next_probe = now + PROBE_PERIOD_S
            with suppress(AssertionError):
                self.requests.ask(AT_ONCE)
            self._look()

    @property
    def is_answered(self) -> bool:
        """True if every request has its answer."""
        return not self.requests.open and all(each.ended is not None for each in self._looks)

    def report(self, high: Mapping[str, Sequence[int]]) -> dict[str, Any]:
        """Return the latencies and the defects of all answers.

        Args:
            high: the stamps of the high levels of each vehicle.
        """
        defects: defaultdict[str, list[str]] = defaultdict(list)
        for each in self.requests.asked:
            kind, text = _defect(each, high)
            if kind:
                defects[kind].append(f'{each.name}: {text}')
        for look in self._looks:
            if look.ended is None:
                defects['lost'].append(look.service)
            elif look.fault:
                defects['wrong'].append(f'{look.service}: {look.fault}')
        return {
            'asked': len(self.requests.asked) + len(self._looks),
            'outcomes': self.requests.outcomes,
            **{kind: defects[kind] for kind in (*DEFECTS, 'refused')},
            'latency_ms': self._latencies(),
        }

    def _look(self) -> None:
        kind, service, fields, is_right = self.chance.choice(_LOOKS)
        look = _Look(service, time.monotonic())
        self._looks.append(look)
        streams = {f'{name}_power' for name in self.system.batteries}
        vehicles = set(self.system.sources)

        def end(look: _Look, done: Any) -> None:
            look.ended = time.monotonic()
            if not is_right(done.result(), streams, vehicles):
                look.fault = str(done.result())[:300]

        future = self._clients[service].call_async(kind.Request(**fields))
        future.add_done_callback(partial(end, look))

    def _latencies(self) -> dict[str, dict[str, float]]:
        found: defaultdict[str, list[float]] = defaultdict(list)
        now = time.monotonic()
        for each in self.requests.asked:
            if each.name == AT_ONCE:
                found['evaluate_formula'].append((each.ended or now) - each.begun)
        for look in self._looks:
            found[look.service].append((look.ended or now) - look.begun)
        return {name: _summary(values) for name, values in sorted(found.items())}


def _defect(request: Request, high: Mapping[str, Sequence[int]]) -> tuple[str, str]:
    """Return the kind of the defect of an answer, `wrong` or so, and what it is; else ''."""
    if request.ended is None:
        return 'lost', 'no answer'
    status, kind = request.answer.exit_status, request.kind
    if not status.code:
        fault = request.fault(high)
        return ('wrong', fault) if fault else ('', '')
    due = _due(request, high)
    if status.code == due:
        return '', ''
    if status.code == ExitStatus.UNAVAILABLE and _LIMIT.search(status.message):
        return 'refused', status.message[:300]
    if status.code == ExitStatus.TIMEOUT and due == _VERDICT and kind.watches:
        return 'missing', f'no verdict, although a level was high: {status.message[:300]}'
    return 'failed', f'error {status.code}: {status.message[:300]}'


_VERDICT = -1
_DUE = {
    'timeout': ExitStatus.TIMEOUT,
    'cancelled': ExitStatus.CANCELLED,
    'bad syntax': ExitStatus.INVALID_ARGUMENT,
    'bad type': ExitStatus.INVALID_ARGUMENT,
    'unknown feature': ExitStatus.NOT_FOUND,
    'unknown object': ExitStatus.NOT_FOUND,
}
"""The exit statuses of requests that get no verdict where nothing fails."""


def _due(request: Request, high: Mapping[str, Sequence[int]]) -> int:
    """Return the exit status that a request must have where nothing fails."""
    if request.name in _DUE:
        return _DUE[request.name]
    if FormulaResult.TRUE in request.kind.verdicts or not request.kind.watches:
        return _VERDICT
    # Without an end, `always` is false after a high level, and else has no verdict.
    begun = time.time_ns() - round((time.monotonic() - request.begun) * 1e9)
    first = begun + 2 * SECOND_NS
    last = begun + round((request.kind.timeout - SLACK_S) * 1e9)
    stamps = (stamp for vehicle in request.vehicles for stamp in high.get(vehicle, ()))
    return _VERDICT if any(first <= stamp <= last for stamp in stamps) else ExitStatus.TIMEOUT


def _summary(seconds: Sequence[float]) -> dict[str, float]:
    """Return the median, the 99th percentile and the most of latencies, milliseconds."""
    figures = (statistics.median(seconds), percentile(seconds, 99), max(seconds))
    names = ('median', 'p99', 'max')
    found = {name: round(each * 1e3, 1) for name, each in zip(names, figures, strict=True)}
    return {**found, 'count': len(seconds)}
