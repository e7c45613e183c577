"""Nodes that are killed while a formula is evaluated: the caller is told, and all works again."""

from __future__ import annotations

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult

from system import ALWAYS, NOTICED, SOON, Batteries, System, assert_decided


def assert_all_is_well(system: System, batteries: Batteries) -> None:
    """Formulas are evaluated again."""
    system.wait_for_streams()
    again = system.evaluate(SOON)
    assert_decided(again, FormulaResult.TRUE)
    assert batteries.power['uav1'] == 100.0


@pytest.mark.parametrize('executable', ['stream_processing_engine', 'stream_reasoning_engine'])
def test_a_node_killed_during_an_evaluation(
    system: System, batteries: Batteries, executable: str
) -> None:
    future = system.ask(ALWAYS, timeout=60.0)
    system.wait_until_running(future)
    with system.killed(executable):
        answer = system.client.result(future, 'the answer', NOTICED)
        assert answer.exit_status.code == ExitStatus.UNAVAILABLE
        assert executable.replace('_', ' ') in answer.exit_status.message.replace('_', ' ')
        assert answer.verdict == FormulaResult.UNDECIDED
    assert_all_is_well(system, batteries)


@pytest.mark.parametrize(
    'executable', ['stream_manager', 'ontology_manager', 'semantic_matching_engine']
)
def test_a_node_that_is_missing_when_a_formula_is_asked(
    system: System, batteries: Batteries, executable: str
) -> None:
    with system.killed(executable):
        answer = system.evaluate(SOON)
        assert answer.exit_status.code == ExitStatus.UNAVAILABLE
        assert executable in answer.exit_status.message
    assert_all_is_well(system, batteries)
