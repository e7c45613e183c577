"""Peers with clocks that differ, over links that fail, in simulated time.

A run has two to five hosts. The first one asks for a stream of each other one, and evaluates a
formula over all of them, by what its nodes do it with. The true times are known here alone: they
judge the verdict.
"""

from __future__ import annotations

import heapq
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from random import Random

from dyknow_common import NANOSECONDS, SECOND_NS, Alternatives, StreamConstraints, Value, Verdict
from dyknow_configuration import RequestedFederation, RequestedShare
from dyknow_federation.encoding import encode
from dyknow_federation.events import (
    FormulaAnswered,
    PeerEvent,
    StreamViolated,
    ValueKnown,
    WatermarkArrived,
)
from dyknow_federation.messages import FormulaRequest, Packet, SharedFeature, StreamFault
from dyknow_federation.peer import Effects, Peer
from dyknow_federation.push_down import UNDECIDED, PushDown, verdict_text
from dyknow_reasoning import FormulaGroup, parse_formula
from dyknow_stream_processing import Dataflow, Sample, Violation, parse_specification

MS = NANOSECONDS['ms']
STREAM = 'level'
BEFORE = -(2**63)

FORMULAS = (
    'forall r in Robot: always[0 s, {w} s] Level[r] < 9',
    'always[0 s, {w} s] (Level[h0] > 5 -> eventually[0 s, {v} s] Level[h1] > 5)',
    'eventually[0 s, {w} s] (Level[h0] > 5 and Level[h1] > 5)',
    'always[0 s, {w} s] (Level[h0] > 2 or Level[h1] > 2)',
    'always[0 s, {w} s] Level[h0] != Level[h1]',
    'Level[h0] < 8 until[0 s, {w} s] Level[h1] > 6',
    'eventually[0 s, {w} s] forall r in Robot: Level[r] > 4',
    'always[0 s, {w} s] (Level[h0] < Level[h1] -> eventually[0 s, {v} s] Level[h0] >= Level[h1])',
    'always[0 s, {w} s] (Level[h1] <= 3 or Level[h1] > 5 or eventually[0 s, {v} s] Level[h1] = 7)',
)


def constants(formula: str) -> tuple[float, ...]:
    """With what a formula compares levels; nothing if it compares them with each other."""
    if re.search('[<>=] Level', formula):
        return ()
    return tuple(sorted({float(each) for each in re.findall('[<>=] ([0-9]+)', formula)}))


@dataclass(frozen=True, slots=True)
class Conditions:
    """The worst that a run may have; durations are in nanoseconds.

    Args:
        offset: of a clock.
        drift_ppm: of a clock.
        loss: the share of packets that are lost.
        duplicates: the share of packets that arrive twice.
        delay: of a packet at least.
        jitter: more delay, on average.
        outage: of a link.
        restarts: True if hosts restart.
        violations: True if the sensors of hosts fail, and their hosts report it.
        deadbands: True if hosts send some values only if they have changed enough.
        comparisons: the share of runs in which hosts send only what compares otherwise with the
            constants of the formula, if it does nothing else with values.
    """

    offset: int = 5 * SECOND_NS
    drift_ppm: float = 50
    loss: float = 0.2
    duplicates: float = 0.05
    delay: int = 30 * MS
    jitter: int = 10 * MS
    outage: int = 10 * SECOND_NS
    restarts: bool = True
    violations: bool = True
    deadbands: bool = True
    comparisons: float = 0.5


@dataclass(slots=True)
class Clock:
    """A clock that reads `offset` at the true time 0, and is fast by `drift`."""

    offset: int
    drift: float

    def read(self, true_time: int) -> int:
        return true_time + self.offset + int(true_time * self.drift)

    def when(self, reading: int) -> int:
        """A true time at which it reads at least this."""
        found = int((reading - self.offset) / (1 + self.drift))
        while self.read(found) < reading:
            found += 1
        return found


@dataclass(slots=True)
class Host:
    """A host and what it has published, by true times."""

    name: str
    clock: Clock
    peer: Peer
    period: int
    deadband: float | None
    wakes_at: int = 0
    is_down: bool = False
    is_silent: bool = False
    times: list[int] = field(default_factory=list)
    values: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended.

    Args:
        kind: `right`, `wrong`, `unknown`, or `hang`.
        error: the error of one that is unknown.
        allowed: True if no clock was too uncertain for any tick.
        detail: what describes the run.
    """

    kind: str
    error: str
    allowed: bool
    detail: str


class Simulation:
    """A run.

    Args:
        seed: decides all of it.
        conditions: the worst that it may have.
    """

    duration = 14 * SECOND_NS
    drain = 16 * SECOND_NS

    def __init__(self, seed: int, conditions: Conditions | None = None) -> None:
        self.random = random = Random(seed)  # noqa: S311 - to be repeated
        self.conditions = conditions or Conditions()
        self._network = Random(seed)  # noqa: S311 - the hosts do the same over all links
        self._queue: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0
        self._now = 0
        self.packets = 0
        self.most_alternatives = 0
        self.hosts = [self._host(f'h{number}') for number in range(random.randint(2, 5))]
        self._lossy = {
            (one.name, two.name): random.random() < 0.5 for one in self.hosts for two in self.hosts
        }
        self._delays = {
            (one.name, two.name): random.randint(200_000, self.conditions.delay)
            for one in self.hosts
            for two in self.hosts
        }
        self._outages = [self._outage() for _ in range(random.choice((0, 0, 1, 2)))]
        self._period = random.choice((100, 200, 250, 500)) * MS
        self._begin_evaluation()
        for host in self.hosts:
            self._share(host)
            self._at(random.randint(0, host.period), lambda host=host: self._publish(host))
            self._wake(host)
        if self.conditions.restarts and random.random() < 0.3:
            self._at(random.randint(0, self.duration), self._restart)
        if self.conditions.violations and random.random() < 0.2:
            self._at(random.randint(0, self.duration), self._violate)

    def run(self) -> Outcome:
        """Run to the end, and judge."""
        end = self.duration + self.drain
        while self._queue and self.result is None and not self.error:
            self._now, _, action = heapq.heappop(self._queue)
            if self._now > end:
                break
            action()
        return self._judge()

    def _host(self, name: str) -> Host:
        random, most = self.random, self.conditions.offset
        offset = 10_000 * SECOND_NS + random.randint(-most, most)
        drift = random.uniform(-1, 1) * self.conditions.drift_ppm * 1e-6
        incarnation = random.getrandbits(60)
        period, deadband = random.choice((100, 200, 500)) * MS, None
        if self.conditions.deadbands:
            deadband = random.choice((None, None, 0, 0.5, 1.5))
        peer = self._peer(name, deadband, incarnation)
        return Host(name, Clock(offset, drift), peer, period, deadband)

    def _peer(self, name: str, deadband: float | None, incarnation: int) -> Peer:
        share = RequestedShare('Level', deadband=deadband)
        settings = RequestedFederation(name, share=(share,), max_uncertainty=3600 * SECOND_NS)
        return Peer(settings, incarnation)

    def _outage(self) -> tuple[str, int, int]:
        """The links of one host, or of all, fail."""
        start = self.random.randint(0, self.duration)
        length = self.random.randint(0, self.conditions.outage)
        name = self.random.choice([*(each.name for each in self.hosts), ''])
        return name, start, start + length

    def _begin_evaluation(self) -> None:
        random, own = self.random, self.hosts[0]
        text = random.choice(FORMULAS)
        self.formula = text.format(w=random.choice((2, 4, 8)), v=random.choice((0.2, 0.5, 1, 2)))
        is_compared = random.random() < self.conditions.comparisons
        self.constants = constants(self.formula) if is_compared else ()
        names = [each.name for each in self.hosts]
        self.domains = {'Robot': names}
        self._begin_states(
            self.formula, [f'select level as "Level[{name}]" from "/{name}"' for name in names]
        )
        for each in self.hosts:
            if each is not own:
                now = own.clock.read(0)
                own.peer.request(each.name, STREAM, now, constants=self.constants)

    def _begin_states(self, formula: str, sources: Iterable[str]) -> None:
        """Evaluate a formula over states that are made from some streams."""
        self.evaluated = self._group(formula)
        self._has_begun: set[str] = set()
        self._dataflow = Dataflow({}, lambda _: None)
        start = self.hosts[0].clock.read(self.random.randint(1, 3) * SECOND_NS)
        self._dataflow.create(
            'states',
            parse_specification(f'sink sync({", ".join(sources)})'),
            StreamConstraints(start_time=start, sample_period=self._period),
            self._progress,
            self._fail,
        )
        self.ticks: list[int] = []
        self.uncertainty = 0
        self.result: Verdict | None = None
        self.error = ''

    def _group(self, formula: str) -> FormulaGroup:
        group = FormulaGroup()
        group.add_formula('', formula)
        group.begin(self.domains)
        return group

    def _share(self, host: Host) -> None:
        feature = SharedFeature('Level', (host.name,), STREAM, 'float', '', host.deadband or 0)
        host.peer.share([], [feature], host.clock.read(self._now))

    def _at(self, time: int, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._queue, (time, self._count, action))

    def _publish(self, host: Host) -> None:
        """A new sample of the host; its level often stays for some time."""
        random = self.random
        if host.is_silent:
            return
        if not host.is_down and self._now < self.duration:
            former = host.values[-1] if host.values else 5.0
            level = float(random.randint(0, 9)) if random.random() < 0.3 else former
            if host.deadband:
                level = min(max(level + random.uniform(-0.4, 0.4), 0), 9)
            reading = host.clock.read(self._now)
            host.times.append(self._now)
            host.values.append(level)
            self._take_sample(host, reading, level)
        if not host.is_down and self._now >= self.duration:
            host.peer.promise(STREAM, host.clock.read(self._now) - 1, host.clock.read(self._now))
            self._own_promise(host)
        self._wake(host)
        self._at(self._now + host.period + random.randint(0, 20 * MS), lambda: self._publish(host))

    def _take_sample(self, host: Host, reading: int, level: float) -> None:
        host.peer.publish(STREAM, reading, level, reading)
        if host is self.hosts[0]:
            self._push(host.name, reading, level)

    def _own_promise(self, host: Host) -> None:
        if host is self.hosts[0]:
            now = host.clock.read(self._now)
            self._dataflow.vouch(f'/{host.name}', now - 1, now)

    def _restart(self) -> None:
        """A host other than the first one stops, and starts again with another clock."""
        host = self.random.choice(self.hosts[1:])
        if host.is_silent:
            return
        host.is_down = True
        self._at(self._now + self.random.randint(0, 3 * SECOND_NS), lambda: self._start(host))

    def _violate(self) -> None:
        """A sensor of a host other than the first one fails: nothing follows but the violation."""
        host = self.random.choice(self.hosts[1:])
        if host.is_down or not host.peer.sent:  # The stream is made when it is asked for.
            self._at(self._now + host.period, self._violate)
            return
        host.is_silent, reading = True, host.clock.read(self._now)
        host.peer.violate(STREAM, StreamFault(reading, 'max_gap', f'{host.name} failed'), reading)
        self._wake(host)

    def _start(self, host: Host) -> None:
        if self.random.random() < 0.5:
            host.clock.offset += self.random.randint(-SECOND_NS, SECOND_NS)
        host.peer = self._peer(host.name, host.deadband, self.random.getrandbits(60))
        host.is_down = False
        host.wakes_at = 0
        self._share(host)
        self._wake(host)

    def _wake(self, host: Host) -> None:
        """Plan the next deadline of a host."""
        due = max(self._now, host.clock.when(host.peer.next_deadline()))
        if host.wakes_at <= self._now or due < host.wakes_at:
            host.wakes_at = due
            self._at(due, lambda: self._advance(host, due))

    def _advance(self, host: Host, due: int) -> None:
        if host.is_down or host.wakes_at != due:
            return
        host.wakes_at = 0
        self._act(host, host.peer.advance(host.clock.read(self._now)))

    def _receive(self, host: Host, data: bytes, sender: str) -> None:
        if not host.is_down:
            self._act(host, host.peer.receive(data, host.clock.read(self._now), sender))

    def _act(self, host: Host, effects: Effects) -> None:
        for receiver, packet in effects.packets:
            self._send(host, receiver, packet)
        if host is self.hosts[0]:
            self._take(effects.events)
        self._wake(host)

    def _send(self, sender: Host, receiver: str, packet: Packet) -> None:
        random, data = self._network, encode(packet)
        for host in self.hosts:
            if host is sender or receiver not in {'', host.name}:
                continue
            self.packets += 1
            link = sender.name, host.name
            lost = self._lossy[link] and random.random() < self.conditions.loss
            if lost or self._is_out(link):
                continue
            for _ in range(1 + (random.random() < self.conditions.duplicates)):
                delay = self._delays[link]
                delay += int(random.expovariate(1 / self.conditions.jitter))
                self._at(
                    self._now + delay, lambda host=host: self._receive(host, data, sender.name)
                )

    def _is_out(self, link: Iterable[str]) -> bool:
        return any(
            start <= self._now < end and (not name or name in link)
            for name, start, end in self._outages
        )

    def _take(self, events: Iterable[PeerEvent]) -> None:
        for event in events:
            match event:
                case ValueKnown(peer, _, time, level):
                    self._note_bounds(peer, time, level)
                    self._has_begun.add(peer)
                    self._push(peer, time, level)
                case WatermarkArrived(peer, _, time):
                    now = self.hosts[0].clock.read(self._now)
                    self._dataflow.vouch(f'/{peer}', time, now)
                case StreamViolated(peer, constraint=constraint, reason=reason):
                    if constraint != 'lost' or peer in self._has_begun:
                        self.error = reason

    def _note_bounds(self, peer: str, time: int, level: Value) -> None:
        offset = self.hosts[0].peer.remotes[peer].clock.offset(time)
        if offset is not None:  # The uncertainty of a sample includes the drift within it.
            self.uncertainty = max(self.uncertainty, offset.uncertainty + MS // 10)
        if isinstance(level, Alternatives):
            self.most_alternatives = max(self.most_alternatives, len(level.values))

    def _push(self, host: str, time: int, level: Value) -> None:
        now = self.hosts[0].clock.read(self._now)
        self._dataflow.push(f'/{host}', Sample(time, now, {'level': level}, time))

    def _fail(self, violation: Violation) -> None:
        self.error = self.error or violation.message

    def _progress(self, state: Sample) -> None:
        if self.result is not None or self.error:
            return
        self.ticks.append(state.valid_time)
        for found in self.evaluated.progress(state.valid_time, state.fields):
            self.result = None if found.error else found.verdict
            self.error = str(found.error or '')

    def _truth(self, hosts: list[Host]) -> list[tuple[int, Mapping[str, Value]]]:
        """The true states of hosts at the ticks since the evaluation began."""
        clock, found = self.hosts[0].clock, list[tuple[int, Mapping[str, Value]]]()
        readings = [[clock.read(time) for time in host.times] for host in hosts]
        for tick in self.ticks:
            values = {}
            for host, times in zip(hosts, readings, strict=True):
                values[f'Level[{host.name}]'] = host.values[bisect_right(times, tick) - 1]
            found.append((tick, values))
        return found

    def _true_verdict(
        self, formula: str, states: Iterable[tuple[int, Mapping[str, Value]]]
    ) -> Verdict:
        group, verdict = self._group(formula), Verdict.UNDECIDED
        for time, values in states:
            for result in group.progress(time, values):
                verdict = result.verdict
        return verdict

    def _judge(self) -> Outcome:
        offsets = [round((each.clock.offset / SECOND_NS) - 10_000, 3) for each in self.hosts]
        detail = f'{self.formula}, period {self._period / SECOND_NS} s, offsets {offsets}'
        allowed = self._is_allowed()
        if self.error:
            return Outcome('unknown', self.error, allowed, detail)
        if self.result is None and not self.ticks:
            return Outcome('unknown', 'it has not begun: a value never arrived', allowed, detail)
        if self.result is None:
            return Outcome('hang', f'waits after {self.ticks[-1]}', allowed, detail)
        verdict = self._true_verdict(self.formula, self._truth(self.hosts))
        kind = 'right' if verdict is self.result else 'wrong'
        return Outcome(kind, '', allowed, f'{detail}: {self.result.name}, truly {verdict.name}')

    def _is_allowed(self) -> bool:
        """Return True if no sample that changes a level is as near to a tick as clocks differ."""
        clock = self.hosts[0].clock
        changes = sorted(
            clock.read(time)
            for host in self.hosts[1:]
            for number, time in enumerate(host.times)
            if number and host.values[number] != host.values[number - 1]
        )
        for tick in self.ticks:
            near = bisect_right(changes, tick - 2 * self.uncertainty - 2)
            if near < len(changes) and changes[near] <= tick + 2 * self.uncertainty + 2:
                return False
        return True


PUSHED = (
    'forall r in Robot: always[0 s, {w} s] Level[r] < 9',
    'exists r in Robot: always[0 s, {w} s] (Level[r] > 5 -> eventually[0 s, {v} s] Level[r] < 5)',
    '(always[0 s, {w} s] Level[h0] > 0) or not eventually[0 s, {w} s] Level[h1] > 8',
    '(Level[h1] < 8 until[0 s, {w} s] Level[h1] > 6) and eventually[0 s, {w} s] Level[h0] > 4',
)
"""Formulas with parts for peers; parts about the first host remain."""


@dataclass(slots=True)
class PeerEvaluation:
    """The evaluation of a part by its host."""

    group: FormulaGroup
    text: str = UNDECIDED


class PushDownSimulation(Simulation):
    """A run in which hosts evaluate the parts of the formula that are about them."""

    def _begin_evaluation(self) -> None:
        random = self.random
        text = random.choice(PUSHED)
        self.formula = text.format(w=random.choice((2, 4, 8)), v=random.choice((0.2, 0.5, 1, 2)))
        self.constants = ()
        self.domains = {'Robot': [each.name for each in self.hosts]}
        streams = {f'Level[{each.name}]': (each.name, STREAM) for each in self.hosts[1:]}
        found = PushDown(parse_formula(self.formula), self.domains, streams)
        self.parts = {f'_h0_{number}': part for number, part in enumerate(found.parts)}
        self.evaluations: dict[str, PeerEvaluation] = {}
        self.remaining = found.remaining({part: name for name, part in self.parts.items()})
        sources = [f'select value as "{each}.value" from "/{each}"' for each in self.parts]
        if self._reads_own_level():
            sources.append('select level as "Level[h0]" from "/h0"')
        self._begin_states(self.remaining, sources)
        for name in self.parts:
            self._at(0, lambda name=name: self._ask(name))

    def _ask(self, name: str) -> None:
        own, part = self.hosts[0], self.parts[name]
        now = own.clock.read(self._now)
        own.peer.request_formula(part.peer, FormulaRequest(name, part.text), now)
        self._wake(own)

    def _reads_own_level(self) -> bool:
        return 'Level[h0]' in map(str, self._group(self.remaining).symbols())

    def _publish(self, host: Host) -> None:
        super()._publish(host)
        if host.is_silent:  # Its sensor is, and not the host.
            self._at(self._now + host.period, lambda: self._publish(host))
        if host.is_down:
            return
        reading, peer = host.clock.read(self._now), host.peer
        for name in peer.formulas.keys() & peer.sent.keys():
            peer.promise(name, reading - 1, reading)
            if name not in self.evaluations:
                self.evaluations[name] = PeerEvaluation(self._group(self.parts[name].text))
                peer.publish(name, reading, UNDECIDED, reading)
                self._violate_undecided(host)
            elif not host.is_silent:
                self._evaluate(host, name, reading)
        self._wake(host)

    def _evaluate(self, host: Host, name: str, reading: int) -> None:
        evaluation = self.evaluations[name]
        for found in evaluation.group.progress(reading, {'level.value': host.values[-1]}):
            is_true = found.verdict is Verdict.TRUE
            evaluation.text = verdict_text(is_true=is_true, reason='so')
            host.peer.publish(name, reading, evaluation.text, reading)

    def _violate(self) -> None:
        super()._violate()
        for host in self.hosts:
            self._violate_undecided(host)

    def _violate_undecided(self, host: Host) -> None:
        """End the evaluations of a host whose sensor has failed."""
        reading = host.clock.read(self._now)
        fault = StreamFault(reading, 'max_gap', f'{host.name} failed')
        undecided = {name for name, each in self.evaluations.items() if each.text == UNDECIDED}
        for name in undecided & host.peer.sent.keys() if host.is_silent else ():
            host.peer.violate(name, fault, reading)

    def _take(self, events: Iterable[PeerEvent]) -> None:
        for event in events:
            match event:
                case FormulaAnswered(peer, stream, ''):
                    now = self.hosts[0].clock.read(self._now)
                    self.hosts[0].peer.request(peer, stream, now)
                case FormulaAnswered(stream=stream):  # Hosts have not found each other yet.
                    self._at(self._now + SECOND_NS, lambda stream=stream: self._ask(stream))
                case ValueKnown(peer, stream, time, text):
                    self._has_begun.add(stream)
                    now = self.hosts[0].clock.read(self._now)
                    self._dataflow.push(f'/{stream}', Sample(time, now, {'value': text}, time))
                case WatermarkArrived(_, stream, time):
                    now = self.hosts[0].clock.read(self._now)
                    self._dataflow.vouch(f'/{stream}', time, now)
                case StreamViolated(_, stream, constraint, reason):
                    if constraint != 'lost' or stream in self._has_begun:
                        self.error = reason

    def _judge(self) -> Outcome:
        """Judge by what the hosts have found, whenever it has come."""
        detail = f'{self.formula}, period {self._period / SECOND_NS} s'
        if self.error:
            return Outcome('unknown', self.error, False, detail)
        if self.result is None:
            kind = 'hang' if self.ticks else 'unknown'
            return Outcome(kind, 'it waits, or has not begun', False, detail)
        told = {f'{name}.value': UNDECIDED for name in self.parts}
        told |= {f'{name}.value': each.text for name, each in self.evaluations.items()}
        own = self.hosts[:1] if self._reads_own_level() else []
        states = ((time, {**values, **told}) for time, values in self._truth(own))
        verdict = self._true_verdict(self.remaining, states)
        kind = 'right' if verdict is self.result else 'wrong'
        return Outcome(kind, '', False, f'{detail}: {self.result.name}, truly {verdict.name}')
