"""The states of a watched formula, which close and open a gate."""

from __future__ import annotations

from math import nan

import pytest

from dyknow_common import DyKnowError
from dyknow_reactions.guard.gate import Gate, GateReports, GateState
from dyknow_reactions.guard.watched_formula import WatchedStates
from dyknow_reasoning import ALL_KNOWN, UnknownFeatures

TIMEOUT = 300
ROVERS = {'Rover': ('r1', 'r2')}


class Guarded:
    """A gate with one formula, whose states are received as soon as they are valid."""

    def __init__(self, formula: str, domains: dict[str, tuple[str, ...]] | None = None) -> None:
        self.now = 0
        self.gate = Gate(['f'], [], TIMEOUT, latch=False)
        self.reports = GateReports(
            self.gate, lambda: self.now, lambda valid: max(self.now - valid, 0), lambda _: None
        )
        self.formula = formula
        self.states = WatchedStates('f', self.reports)
        self.begin(domains or {})

    def begin(
        self, domains: dict[str, tuple[str, ...]], unknown: UnknownFeatures = ALL_KNOWN
    ) -> None:
        self.states.begin(self.formula, domains, unknown)

    def receive(self, valid_time: int, **values: float) -> None:
        """Receive a state; of each feature `Ahead_r1`, it is Ahead[r1] that has the value."""
        self.now = max(self.now, valid_time)
        named = {name.replace('_', '[') + ']' * ('_' in name): x for name, x in values.items()}
        self.states.receive(valid_time, named)

    @property
    def is_open(self) -> bool:
        self.gate.update(self.now)
        return self.gate.state is GateState.OPEN


def test_a_formula_about_the_past_that_lacks_states_begins_anew() -> None:
    guarded = Guarded('x - prev(x) < 3')
    for valid_time in (100, 200):
        guarded.receive(valid_time, x=1.0)
    assert guarded.is_open
    guarded.states.gap()
    with pytest.raises(DyKnowError, match='look back on states that are missing'):
        guarded.receive(300, x=1.0)
    guarded.states.fail('it cannot be asked')
    assert not guarded.is_open
    guarded.begin({})
    for valid_time in (400, 500):
        guarded.receive(valid_time, x=1.0)
    assert guarded.is_open


def test_a_lost_state_is_no_error_without_the_past() -> None:
    guarded = Guarded('x < 3')
    guarded.receive(100, x=1.0)
    guarded.states.gap()
    guarded.receive(300, x=1.0)
    assert guarded.is_open
    guarded.states.gap()
    guarded.receive(400, x=5.0)
    assert not guarded.is_open


@pytest.mark.parametrize('later', [0.0, nan])
def test_unknown_values_before_a_gap_close_the_gate_until_they_make_no_difference(
    later: float,
) -> None:
    """The formula is false from 100 if Ahead was less than 1 there."""
    guarded = Guarded('Ahead < 1 -> always[0 ns, 300 ns] x < 5')
    guarded.begin({}, UnknownFeatures({'Ahead': (0.0, 9.0)}))
    guarded.receive(100, Ahead=nan, x=1.0)
    assert guarded.is_open
    guarded.states.gap()
    guarded.receive(300, Ahead=2.0, x=7.0)
    assert not guarded.is_open
    assert 'want of unknown values until 0.0000001 s, after which states are missing' in (
        guarded.gate.reason
    )
    guarded.receive(400, Ahead=2.0, x=7.0)
    assert not guarded.is_open
    guarded.receive(500, Ahead=2.0, x=7.0)
    assert guarded.is_open
    guarded.receive(600, Ahead=later, x=7.0)
    assert not guarded.is_open


def test_unknown_values_before_a_gap_that_always_make_a_difference() -> None:
    guarded = Guarded('Ahead < 1 -> always x < 5')
    guarded.begin({}, UnknownFeatures({'Ahead': (0.0, 9.0)}))
    guarded.receive(100, Ahead=nan, x=1.0)
    guarded.states.gap()
    with pytest.raises(DyKnowError, match='after which states are missing'):
        guarded.receive(200, Ahead=2.0, x=1.0)


@pytest.mark.parametrize(
    ('domains', 'unknown'),
    [({'Rover': ('r1',)}, ALL_KNOWN), (ROVERS, UnknownFeatures({'Ahead': (0.0, 9.0)}))],
)
def test_other_objects_close_the_gate_until_their_first_state(
    domains: dict[str, tuple[str, ...]], unknown: UnknownFeatures
) -> None:
    guarded = Guarded('forall r in Rover: Ahead[r] > 1', ROVERS)
    guarded.receive(100, Ahead_r1=2.0, Ahead_r2=2.0)
    assert guarded.is_open
    guarded.begin(domains, unknown)
    assert not guarded.is_open
    assert guarded.gate.reason == 'f: its objects have changed, and no state has come since'
    guarded.receive(200, Ahead_r1=2.0, Ahead_r2=2.0)
    assert guarded.is_open


def test_other_states_of_the_same_objects_leave_it_open() -> None:
    guarded = Guarded('forall r in Rover: Ahead[r] > 1', ROVERS)
    guarded.receive(100, Ahead_r1=2.0, Ahead_r2=2.0)
    guarded.begin(ROVERS)
    assert guarded.is_open
    guarded.receive(100, Ahead_r1=0.0, Ahead_r2=2.0)
    assert not guarded.is_open


@pytest.mark.parametrize(('formula', 'verdict'), [('exists', 'false'), ('forall', 'true')])
def test_a_formula_that_needs_no_state(formula: str, verdict: str) -> None:
    """The gate does not open: nothing tells that its states would come."""
    guarded = Guarded(f'{formula} r in Rover: Ahead[r] > 1', ROVERS)
    guarded.receive(100, Ahead_r1=2.0, Ahead_r2=2.0)
    guarded.begin({'Rover': ()})
    assert not guarded.is_open
    assert guarded.gate.reason == f'f: it is {verdict} at any state'
