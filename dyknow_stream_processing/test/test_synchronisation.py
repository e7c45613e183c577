"""Sync against a slow reference that follows the definition step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from hypothesis import example, given
from hypothesis import strategies as st

from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing import (
    Dataflow,
    DelayLimits,
    Sample,
    SourceType,
    parse_specification,
)

Event = tuple[int, int, int]  # now, input, valid time
Output = tuple[int, int, tuple[int, ...]]  # now, tick, the number of the sample of each input
STEP = 1000
"""The nanoseconds between times, so that samples of one time fit in between."""
END = 60 * STEP
NEVER = -1000 * STEP
SELECT = 'select'
LIMITS = DelayLimits(stamped=7 * STEP, sent=4 * STEP)


@dataclass
class NaiveInput:
    """One input of the reference: what it has delivered, and what can still come."""

    max_delay: int | None = None
    receipt_time: bool = False
    sent_time: bool = False
    modulus: int = 1
    max_lead: int | None = None
    is_ordered: bool = False
    seen: list[tuple[int, int]] = field(default_factory=list)
    newest: int = NEVER
    times: dict[int, int] = field(default_factory=dict)
    """The valid times at which its samples count, by their numbers."""

    def term(self, port: int) -> str:
        limits = {'max_delay': self.max_delay, 'max_lead': self.max_lead}
        given = ', '.join(f'{name} = {n} ns' for name, n in limits.items() if n is not None)
        text = f'{SELECT} n as n{port} from "{port}" where m{self.modulus} = 0'
        return f'{text} with {given}' if given else text

    def take(self, valid_time: int, number: int, now: int) -> None:
        if self.max_lead is not None and valid_time - now > self.max_lead:
            return
        if self.is_ordered and self.max_delay is not None and number % self.modulus == 0:
            if valid_time < self.newest:
                return
            self.newest = valid_time
        allowed = self.max_delay
        if allowed is None:
            allowed = LIMITS.sent if self.sent_time else LIMITS.stamped
        if now - valid_time > allowed:
            return
        newest = max((time for time, _ in self.seen), default=valid_time)
        if self.sent_time and self.max_delay is None:
            valid_time = max(valid_time, newest)
        if self.max_delay is not None or valid_time >= newest:
            self.seen.append((valid_time, number))

    def delivered(self, now: int) -> list[tuple[int, int]]:
        """The samples received, in order; with a max_delay, those that have waited for it."""
        held = self.max_delay or 0
        if self.receipt_time:
            held = 0
        passes = self.max_delay is None or self.is_ordered
        return sorted(
            (each for each in self.seen if passes or each[0] + held <= now),
            key=lambda each: each[0],
        )

    def passing(self, now: int, last_tick: int = NEVER) -> list[tuple[int, int]]:
        """The samples that count: each after those of its input, and after the last tick."""
        for time, number in self.delivered(now):
            if number % self.modulus == 0 and number not in self.times:
                after = max([last_tick, *self.times.values()])
                self.times[number] = max(time, after + 1)
        return [(time, number) for number, time in self.times.items()]

    def is_done(self, tick: int, now: int) -> bool:
        # What has a max_delay is put in order after it has passed the conditions.
        overtaken = self.max_delay is None and any(time > tick for time, _ in self.delivered(now))
        if overtaken or any(time >= tick for time, _ in self.passing(now)):
            return True
        lag = LIMITS.sent if self.sent_time and self.max_delay is None else self.max_delay
        lag = 0 if self.receipt_time else lag
        return lag is not None and now > tick + lag


def naive(
    inputs: Sequence[NaiveInput], events: Sequence[Event], period: int | None, start: int | None
) -> list[Output]:
    """The definition, evaluated anew after every single step of time and every event."""
    outputs: list[Output] = []
    origin, last = start, NEVER
    for now in range(0, END, STEP):
        arrivals = [each for each in enumerate(events) if each[1][0] == now]
        for arrival in [None, *arrivals]:
            if arrival is not None:
                number, (_, port, valid_time) = arrival
                inputs[port].take(valid_time, number, now)
            heads = sorted(time for each in inputs for time, _ in each.passing(now, last))
            if origin is None and heads and all(each.is_done(heads[0], now) for each in inputs):
                origin = heads[0]
            ticks = [] if origin is None else list(range(origin, END, period or STEP))
            if period is None:
                ticks = sorted(set(heads))
            for tick in ticks:
                if tick <= last:
                    continue
                if not all(each.is_done(tick, now) for each in inputs):
                    break
                last = tick
                values = [[n for time, n in each.passing(now) if time <= tick] for each in inputs]
                if all(values):
                    outputs.append((now, tick, tuple(each[-1] for each in values)))
    return outputs


def run(
    inputs: Sequence[NaiveInput],
    events: Sequence[Event],
    period: int | None = None,
    start: int | None = None,
    form: str = 'sync({})',
) -> list[Output]:
    outputs: list[Output] = []
    clock = 0

    def source_type(topic: str) -> SourceType:
        source = inputs[int(topic)]
        return SourceType(None, source.receipt_time, source.is_ordered, source.sent_time)

    dataflow = Dataflow({}, source_type, delays=LIMITS)

    def on_sample(sample: Sample) -> None:
        numbers = tuple(int(sample.fields[f'n{port}']) for port in range(len(inputs)))
        outputs.append((clock, sample.valid_time, numbers))

    text = form.format(', '.join(each.term(port) for port, each in enumerate(inputs)))
    constraints = {'start_time': start, 'sample_period': period}
    given = ', '.join(f'{name} = {n} ns' for name, n in constraints.items() if n is not None)
    text = f'{text} with {given}' if given else text
    dataflow.create('s', parse_specification(text), NO_CONSTRAINTS, on_sample, lambda _: None)
    for now in range(0, END, STEP):
        clock = now
        dataflow.advance(now)
        for number, (time, port, valid_time) in enumerate(events):
            if time == now:
                fields = {'n': number} | {f'm{modulus}': number % modulus for modulus in (1, 2, 3)}
                dataflow.push(str(port), Sample(valid_time, now, fields))
    return outputs


def times(least: int, most: int) -> st.SearchStrategy[int]:
    return st.integers(least, most).map(STEP.__mul__)


@st.composite
def situations(
    draw: st.DrawFn,
) -> tuple[list[NaiveInput], list[Event]]:
    inputs = [
        NaiveInput(
            max_delay=draw(st.none() | times(0, 8)),
            receipt_time=draw(st.booleans()),
            sent_time=draw(st.booleans()),
            modulus=draw(st.sampled_from([1, 1, 2, 3])),
            max_lead=draw(st.none() | times(0, 4)),
            is_ordered=draw(st.booleans()),
        )
        for _ in range(draw(st.integers(1, 3)))
    ]
    for each in inputs:
        if each.receipt_time:
            each.max_delay, each.sent_time = None, False
    arrivals = draw(st.lists(st.tuples(times(0, 40), times(-6, 10)), min_size=3, max_size=25))
    ports = st.integers(0, len(inputs) - 1)
    events = []
    for now, delay in sorted(arrivals, key=lambda each: each[0]):
        port = draw(ports)
        events.append((now, port, now if inputs[port].receipt_time else now - delay))
    return inputs, events


def fresh(inputs: Sequence[NaiveInput]) -> list[NaiveInput]:
    return [replace(each, seen=[], times={}) for each in inputs]


@given(situations())
def test_every_valid_time_is_a_tick(situation: tuple[list[NaiveInput], list[Event]]) -> None:
    inputs, events = situation
    assert run(inputs, events, None, None) == naive(fresh(inputs), events, None, None)


@given(situations(), times(1, 7), st.none() | times(0, 20))
@example(([NaiveInput(), NaiveInput()], []), STEP, None)
def test_ticks_at_a_period(
    situation: tuple[list[NaiveInput], list[Event]], period: int, start: int | None
) -> None:
    inputs, events = situation
    assert run(inputs, events, period, start) == naive(fresh(inputs), events, period, start)


def without_repeats(inputs: Sequence[NaiveInput], events: Sequence[Event]) -> list[Event]:
    """The events without repeated valid times: with an inner `sync`, those count at other times.

    A message without a stamp that another one has overtaken is as if it were sent with that one.
    """
    latest: dict[int, int] = {}
    distinct = {(port, time): (now, port, time) for now, port, time in events}
    found = []
    for now, port, time in sorted(distinct.values()):
        if not inputs[port].sent_time or time > latest.get(port, NEVER):
            found.append((now, port, time))
        latest[port] = max(time, latest.get(port, NEVER))
    return found


@given(situations(), st.none() | times(1, 7))
def test_a_sync_of_one_sync_is_the_same(
    situation: tuple[list[NaiveInput], list[Event]], period: int | None
) -> None:
    inputs, events = situation
    distinct = without_repeats(inputs, events)
    nested = run(inputs, distinct, period, form='sync(sync({}))')
    # The ticks of the outer one begin where the inner one has its first.
    start = nested[0][1] if nested else None
    flat = run(inputs, distinct, period, start)
    assert nested == (flat if nested else [])


@given(situations())
def test_syncs_within_a_sync_are_one(situation: tuple[list[NaiveInput], list[Event]]) -> None:
    inputs, events = situation
    ordered = without_repeats(inputs, events)
    first, *others = (each.term(port) for port, each in enumerate(inputs))
    for form in (
        f'sync(sync({first}), {", ".join(others)})' if others else 'sync({})',
        f'sync({", ".join(others)}, sync({first}))' if others else 'sync({})',
        f'sync({first}, sync({", ".join(others)}))' if others else 'sync({})',
    ):
        assert run(inputs, ordered, form=form) == run(inputs, ordered)
