"""Probabilities that real nodes evaluate."""

from __future__ import annotations

from dyknow_common import Verdict
from dyknow_coordinator import Answer
from dyknow_coordinator.ros import FormulaClient
from system import Batteries, System

STATED = 'let Power ~ normal(Power, 4 W, 0 s) in forall u in UAV: '


def test_a_formula_asks_for_probabilities(system: System, batteries: Batteries) -> None:
    """The estimates are 100 W, 2.5 and 0.5 deviations from the limits."""
    assert set(batteries.power.values()) == {100.0}
    system.wait_for_streams()
    with FormulaClient(system.client.node) as client:
        texts = (
            f'{STATED}always[0 s, 300 ms] P(Power[u] < 110 W) >= 0.99',
            f'{STATED}P(always[0 s, 300 ms] Power[u] < 102 W) >= 0.9',
        )
        monitors = [client.monitor(text) for text in texts]
        for each in monitors:
            system.client.spin_until(each.outcome.done, 'the verdict')
        true, false = (each.outcome.result() for each in monitors)
    system.wait_for_streams()
    assert isinstance(true, Answer)
    assert isinstance(false, Answer)
    assert (true.verdict, false.verdict) == (Verdict.TRUE, Verdict.FALSE)
    assert 'at most 0.691463, assuming independent errors' in false.explanation
