"""Random requests over a fleet, and their possible answers.

`python benchmarks/random_requests.py SECONDS` sends three formulas, as a client to be killed.
"""

from __future__ import annotations

import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from processes import Client
from rclpy.action import ActionClient
from rclpy.task import Future
from running_system import COORDINATOR, EVALUATE, ask, outcome_of

from dyknow_common import SECOND_NS
from dyknow_common.ros import SERVICE, nanoseconds_to_duration, time_to_nanoseconds

PROGRAM = Path(__file__)

MAX_DELAY_S = 6.0
"""Maximum time from the timeout of a request to its answer."""

WINDOW_S = 2
"""Length of the windows in formulas."""

MARGIN_NS = SECOND_NS // 4
"""Time at both ends of a window that is ignored: five states."""

MAX_AGE_NS = SECOND_NS
"""Maximum age of a value: a silent stream violates its constraints."""

FAILURES = frozenset({ExitStatus.UNAVAILABLE, ExitStatus.CONSTRAINT_VIOLATION, ExitStatus.TIMEOUT})
"""Errors that any request may get while nodes and topics fail."""


@dataclass(frozen=True)
class Kind:
    """A kind of request.

    Args:
        formula: with a placeholder for a vehicle.
        verdicts: the correct ones.
        failures: the possible errors.
        timeout: seconds.
        watches: True if its verdict depends on high levels.
        cancelled_after: seconds after which a monitored formula is cancelled; None: not monitored.
    """

    formula: str
    verdicts: frozenset[int] = frozenset()
    failures: frozenset[int] = FAILURES
    timeout: float = 10.0
    watches: bool = False
    cancelled_after: float | None = None


_TRUE = frozenset({FormulaResult.TRUE})
_FALSE = frozenset({FormulaResult.FALSE})
_REFUSED = FAILURES | {ExitStatus.INVALID_ARGUMENT}
_UNKNOWN = FAILURES | {ExitStatus.NOT_FOUND}
_CANCELLED = FAILURES | {ExitStatus.CANCELLED}
_ALL = 'forall u in UAV: always Power[u] < 100'

KINDS = {
    'true at once': Kind('forall u in UAV: Power[u] > 0', _TRUE),
    'true soon': Kind(f'always[0 s, {WINDOW_S} s] Power[{{}}] < 1000', _TRUE),
    'false soon': Kind(f'eventually[0 s, {WINDOW_S} s] Power[{{}}] > 1000', _FALSE),
    'held': Kind(f'always[0 s, {WINDOW_S} s] Power[{{}}] < 100', _TRUE | _FALSE, watches=True),
    'held for ever': Kind('always Power[{}] < 100', _FALSE, watches=True),
    'held by all': Kind(_ALL, _FALSE, timeout=20.0, watches=True),
    'timeout': Kind('always Power[{}] < 1000', timeout=1.0),
    'cancelled': Kind('always Power[{}] < 1000', failures=_CANCELLED, cancelled_after=1.5),
    'monitored': Kind(f'always[0 s, {WINDOW_S} s] Power[{{}}] < 1000', _TRUE, cancelled_after=30.0),
    'bad syntax': Kind('always Power[{}] <', failures=_REFUSED),
    'bad type': Kind('Power[{}] and true', failures=_REFUSED),
    'unknown feature': Kind('always Powr[{}] < 100', failures=_UNKNOWN),
    'unknown object': Kind('always Power[nobody] < 100', failures=_UNKNOWN),
}


@dataclass
class Request:
    """A request and its answer; times of the monotonic clock, seconds."""

    name: str
    vehicles: Sequence[str]
    begun: float
    answer: Any = None
    ended: float | None = None

    @property
    def kind(self) -> Kind:
        """The kind of the request."""
        return KINDS[self.name]

    @property
    def outcome(self) -> str:
        """The outcome in a word or two."""
        return outcome_of(self.answer)

    def fault(self, high: Mapping[str, Sequence[int]], max_delay_s: float = MAX_DELAY_S) -> str:
        """Return the defect of the answer; empty if there is none.

        Args:
            high: the stamps of the high levels of each vehicle.
            max_delay_s: the time after the timeout within which an answer must come.
        """
        if self.ended is None:
            return 'not answered'
        if self.ended - self.begun > self.kind.timeout + max_delay_s:
            return f'answered after {self.ended - self.begun:.1f} s: {self.outcome}'
        code, verdict = self.answer.exit_status.code, self.answer.verdict
        if code:
            return '' if code in self.kind.failures else f'error {self.answer.exit_status}'
        if verdict not in self.kind.verdicts:
            return f'verdict {verdict}'
        return self._wrong_verdict(high) if self.kind.watches else ''

    def _wrong_verdict(self, high: Mapping[str, Sequence[int]]) -> str:
        decided = time_to_nanoseconds(self.answer.decided_at)
        stamps = [stamp for vehicle in self.vehicles for stamp in high.get(vehicle, ())]
        if self.answer.verdict == FormulaResult.FALSE:
            seen = any(decided - MAX_AGE_NS <= stamp <= decided for stamp in stamps)
            return '' if seen else 'false, and no level was high'
        begun = decided - WINDOW_S * SECOND_NS + MARGIN_NS
        missed = [stamp for stamp in stamps if begun <= stamp <= decided - MARGIN_NS]
        return f'true, and {len(missed)} levels were high' if missed else ''


@dataclass
class RandomRequests:
    """Clients that send random requests."""

    client: Client
    vehicles: Sequence[str]
    chance: random.Random
    max_open: int = 12
    asked: list[Request] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._monitor = ActionClient(
            self.client.node,
            MonitorFormula,
            f'{COORDINATOR}/monitor_formula',
            # Answers to others fill the ten places of the default profile, too.
            goal_service_qos_profile=SERVICE,
            result_service_qos_profile=SERVICE,
            cancel_service_qos_profile=SERVICE,
        )
        # A goal that is sent before is lost.
        self.client.spin_until(self._monitor.server_is_ready, 'the action')

    @property
    def open(self) -> list[Request]:
        """The requests without an answer."""
        return [each for each in self.asked if each.ended is None]

    @property
    def outcomes(self) -> dict[str, int]:
        """The outcomes of each kind of request, counted."""
        found = Counter(f'{each.name}: {each.outcome}' for each in self.asked)
        return dict(sorted(found.items()))

    def send(self) -> None:
        """Send a random request, unless many are open."""
        if len(self.open) < self.max_open:
            self.ask(self.chance.choice(list(KINDS)))

    def ask(self, name: str) -> None:
        """Send a request of a kind."""
        vehicle = self.chance.choice(self.vehicles)
        formula = KINDS[name].formula.format(vehicle)
        vehicles = [vehicle] if '{}' in KINDS[name].formula else self.vehicles
        asked = Request(name, vehicles, time.monotonic())
        self.asked.append(asked)

        def end(answer: Any) -> None:
            asked.answer, asked.ended = answer, time.monotonic()

        if asked.kind.cancelled_after is None:
            future = ask(self.client, EVALUATE, formula, asked.kind.timeout)
            future.add_done_callback(lambda done: end(done.result()))
        else:
            self._watch(formula, asked, end)

    def _watch(self, formula: str, asked: Request, end: Callable[[Any], None]) -> None:
        timeout = nanoseconds_to_duration(round(asked.kind.timeout * 1e9))
        goal = MonitorFormula.Goal(formula=formula, timeout=timeout)

        def accepted(done: Future) -> None:
            handle = done.result()
            handle.get_result_async().add_done_callback(lambda found: end(found.result().result))
            self._cancel_later(handle, asked)

        self._monitor.send_goal_async(goal).add_done_callback(accepted)

    def _cancel_later(self, handle: Any, asked: Request) -> None:
        def cancel() -> None:
            self.client.node.destroy_timer(timer)
            if asked.ended is None:
                handle.cancel_goal_async()

        timer = self.client.node.create_timer(asked.kind.cancelled_after, cancel)


def main() -> None:
    """Send requests, and never receive the answers."""
    client = Client()
    for each in range(3):
        ask(client, EVALUATE, f'always Power[uav1] < 1{each}00', float(sys.argv[1]))
    print('begun', flush=True)
    client.spin_until(lambda: False, 'nothing', 1e6)


if __name__ == '__main__':
    main()
