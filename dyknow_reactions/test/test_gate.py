"""The gate of a guard, by hand and against a naive reference."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow_reactions.guard.gate import Gate, GateState

FORMULAS, NODES, TIMEOUT = ('f', 'g'), ('n', 'm'), 5

AT_ONCE = st.just(0)
Event = tuple[str, str, str, int]
"""A kind, a name, a text, and the age of a state or a sign of life."""

EVENTS = st.one_of(
    st.tuples(
        st.just('state'),
        st.sampled_from(FORMULAS),
        st.sampled_from(['', '', '', 'bad']),
        st.integers(0, 7),
    ),
    st.tuples(st.just('fault'), st.sampled_from(FORMULAS), st.just('gone'), AT_ONCE),
    st.tuples(st.just('node'), st.sampled_from(NODES), st.just(''), st.integers(0, 7)),
    st.tuples(st.just('interrupt'), st.just(''), st.just('paused'), AT_ONCE),
    st.tuples(st.just('block'), st.just(''), st.sampled_from(['', 'blocked']), AT_ONCE),
    st.tuples(st.just('reset'), st.just(''), st.just(''), AT_ONCE),
    st.tuples(st.just('look'), st.just(''), st.just(''), AT_ONCE),
)


@dataclass
class Reference:
    """All events so far; the conditions are evaluated anew at every instant."""

    latch: bool
    log: list[tuple[int, Event]] = field(default_factory=list)
    now: int = 0
    is_open: bool = False
    opened: int = 0
    is_latched: bool = False

    def is_well(self) -> bool:
        def latest(kinds: set[str], name: str) -> tuple[int, Event] | None:
            found = [each for each in self.log if each[1][0] in kinds and each[1][1] in {name, ''}]
            return found[-1] if found else None

        for name, kinds in [(f, {'state', 'fault'}) for f in FORMULAS] + [
            (n, {'node'}) for n in NODES
        ]:
            found = latest({*kinds, 'interrupt'}, name)
            own = latest(kinds, name)
            if found is None or own is None or found[1][0] in {'interrupt', 'fault'}:
                return False
            if found[1][2] or self.now - found[0] + found[1][3] > TIMEOUT:
                return False
            times = self.valid_times(name)
            if name in FORMULAS and len(times) > 1 and times[-1] - times[-2] > TIMEOUT:
                return False
        block = latest({'block'}, '')
        return block is None or not block[1][2]

    def valid_times(self, formula: str) -> list[int]:
        """The valid times of the states since the latest fault or interruption."""
        times: list[int] = []
        for time, (kind, name, _, age) in self.log:
            if kind == 'interrupt' or (kind == 'fault' and name == formula):
                times.clear()
            elif kind == 'state' and name == formula:
                times.append(time - age)
        return times

    def look(self) -> None:
        was_open, self.is_open = self.is_open, self.is_well() and not self.is_latched
        if self.is_open and not was_open:
            self.opened = self.now
        if self.latch and was_open and not self.is_open:
            self.is_latched = True

    def advance(self, time: int) -> None:
        while self.now < time:
            self.now += 1
            self.look()

    def take(self, event: Event) -> None:
        self.log.append((self.now, event))
        if event[0] == 'reset' and self.is_well():
            self.is_latched = False
        self.look()


@given(
    st.lists(st.tuples(st.integers(0, 4), EVENTS), max_size=60),
    st.booleans(),
)
@settings(max_examples=max(500, settings.default.max_examples))
def test_it_is_open_exactly_when_all_conditions_hold(
    events: list[tuple[int, Event]],
    latch: bool,  # noqa: FBT001 - drawn by hypothesis
) -> None:
    gate, reference = Gate(FORMULAS, NODES, TIMEOUT, latch=latch), Reference(latch)
    for wait, event in events:
        reference.advance(reference.now + wait)
        now, (kind, name, text, age) = reference.now, event
        reference.take(event)
        match kind:
            case 'state':
                gate.note_state(name, now, text, age=age)
            case 'fault':
                gate.note_fault(name, now, text)
            case 'node':
                gate.note_node(name, now, age=age)
            case 'interrupt':
                gate.interrupt(now, text)
            case 'block':
                gate.block(now, text)
            case 'reset':
                assert gate.reset(now) is reference.is_open
        for since in range(4):
            is_fresh = now - since >= reference.opened
            assert gate.passes(now, age=since) is (reference.is_open and is_fresh)
        assert (gate.state is GateState.LATCHED) is reference.is_latched
        assert bool(gate.reason) is not reference.is_open


def open_gate(*, latch: bool = False) -> Gate:
    gate = Gate(['f'], ['n'], TIMEOUT, latch=latch)
    assert not gate.passes(0)
    gate.note_node('n', 1)
    gate.note_state('f', 1)
    assert gate.passes(1)
    return gate


def test_the_reasons() -> None:
    gate = Gate(['f'], ['n'], TIMEOUT, latch=False)
    assert gate.reason == 'n: no sign of life has come'
    gate.note_node('n', 1)
    assert gate.reason == 'f: no state has come'
    gate.note_state('f', 2, 'x is 3')
    assert gate.reason == 'f: x is 3'
    gate.note_fault('f', 3, 'the stream broke max_gap')
    assert gate.reason == 'f: the stream broke max_gap'
    gate.note_state('f', 4)
    assert (gate.state, gate.reason) == (GateState.OPEN, '')
    assert not gate.passes(7)
    assert gate.reason == 'n: the latest sign of life is older than 5 ns'
    gate.note_node('n', 9)
    assert gate.passes(9)
    gate.note_node('n', 10)
    assert gate.reason == 'f: the latest state is older than 5 ns'
    gate.interrupt(11, 'the clock has jumped')
    assert gate.reason == 'the clock has jumped'
    gate.block(12, 'nobody publishes /cmd_vel_in')
    assert gate.reason == 'nobody publishes /cmd_vel_in'


def test_what_is_too_old_by_one() -> None:
    gate = open_gate()
    assert gate.passes(1 + TIMEOUT)
    assert not gate.passes(2 + TIMEOUT)


def test_a_latch_is_released_only_while_all_is_well() -> None:
    gate = open_gate(latch=True)
    gate.note_state('f', 2, 'x is 3')
    assert gate.state is GateState.LATCHED
    assert not gate.reset(2)
    assert gate.reason == 'f: x is 3'
    gate.note_state('f', 3)
    assert gate.state is GateState.LATCHED
    assert gate.reset(3)
    assert gate.state is GateState.OPEN


def test_a_latch_keeps_a_silence_that_nobody_looked_at() -> None:
    gate = open_gate(latch=True)
    gate.note_node('n', 9)
    gate.note_state('f', 9)
    assert gate.state is GateState.LATCHED


def test_a_latch_does_not_close_what_was_never_open() -> None:
    """A gate without formulas may wait for the type of its messages first."""
    gate = Gate([], [], TIMEOUT, latch=True, block='nobody publishes /cmd_vel_in')
    gate.block(1, 'nobody publishes /cmd_vel_in')
    assert gate.state is GateState.CLOSED
    gate.block(2, '')
    assert gate.state is GateState.OPEN


def test_a_message_that_was_received_while_the_gate_was_closed() -> None:
    """A busy guard may take it after it has opened."""
    gate = open_gate()
    gate.note_state('f', 3, 'x is 3')
    gate.note_state('f', 5)
    assert gate.passes(6, age=1)
    assert not gate.passes(6, age=2)


def test_a_state_that_ends_a_silence_does_not_open() -> None:
    """The violation of its stream comes after it."""
    gate = open_gate()
    for now in (7, 8):
        gate.note_node('n', now)
    gate.note_state('f', 8)
    assert not gate.passes(8)
    assert gate.reason == 'f: the latest state comes 7 ns after its predecessor'
    gate.note_fault('f', 9, 'the stream broke max_gap')
    gate.note_state('f', 10)
    assert gate.passes(10), 'the states of another stream begin'
    gate.note_node('n', 16)
    for now in (16, 17):
        gate.note_state('f', now)
    assert gate.passes(17), 'the states go on'


def test_a_sign_of_life_that_has_waited_counts_from_its_receipt() -> None:
    gate = open_gate()
    gate.note_state('f', 5)
    gate.note_node('n', 6, age=3)
    assert gate.passes(3 + TIMEOUT)
    assert not gate.passes(4 + TIMEOUT)
