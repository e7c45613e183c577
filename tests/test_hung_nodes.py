"""Nodes that stop, hang or are killed while formulas are evaluated, and come back."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult

from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process
from evaluations import Evaluations
from services import nanoseconds
from system import ALWAYS, LIMIT, NOTICED, SOON, Batteries, System, assert_decided

REASONER, ENGINE = 'stream_reasoning_engine', 'stream_processing_engine'
SECOND = 1_000_000_000

_numbers = itertools.count(1)


@pytest.fixture(autouse=True)
def only_fleet_streams(system: System, calm: Batteries) -> None:  # noqa: ARG001 - regular telemetry
    """The test begins with the streams of the fleet alone."""
    system.wait_for_streams()


def assert_unavailable(system: System, future: Any, name: str) -> None:
    """Long before the timeout of the formula, and naming the node."""
    answer = system.client.result(future, 'the answer', NOTICED)
    assert answer.exit_status.code == ExitStatus.UNAVAILABLE, answer.exit_status
    assert name in answer.exit_status.message
    assert answer.verdict == FormulaResult.UNDECIDED


def assert_all_is_well(system: System) -> None:
    """Formulas are evaluated again; it may take a moment until all nodes have met.

    Samples that waited for an engine that was stopped are late, and those that were lost meanwhile
    are sent again even later. Each is a violation.
    """
    system.client.wait_for_coordinator()
    system.wait_for_streams()
    end = time.monotonic() + LIMIT
    answer = system.evaluate(SOON)
    while answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION and time.monotonic() < end:
        assert 'late' in answer.exit_status.message
        answer = system.evaluate(SOON)
    assert_decided(answer, FormulaResult.TRUE)


@pytest.mark.parametrize('executable', [REASONER, ENGINE])
def test_a_node_that_evaluates_stops(
    system: System, evaluations: Evaluations, executable: str
) -> None:
    future = system.ask(ALWAYS, timeout=60.0)
    evaluations.wait_for_state()
    with system.stopped(executable):
        assert_unavailable(system, future, executable)
    assert_all_is_well(system)


def test_all_nodes_that_only_ground_stop(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """Grounded formulas go on, and requests are answered meanwhile."""
    others = (
        'stream_manager',
        'ontology_manager',
        'stream_semantics_manager',
        'semantic_matching_engine',
    )
    future = system.ask(ALWAYS, timeout=60.0)
    evaluations.wait_for_state()
    with system.stopped(*others):
        asked = system.ask(SOON)
        assert_unavailable(system, asked, 'ontology_manager')
        assert not future.done()
        batteries.power['uav2'] = 240.0
        system.decided(future, FormulaResult.FALSE)
    batteries.power['uav2'] = 100.0
    assert_all_is_well(system)


def test_a_hiccup_is_no_failure(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """A node that is stopped for less than the time limit loses nobody a verdict."""
    future = system.ask(ALWAYS, timeout=60.0)
    (before,) = evaluations.wait_for_state()
    for executable in (REASONER, 'stream_reasoning_coordinator', 'stream_manager'):
        system.pause(executable, 0.5)
    (after,) = evaluations.running
    assert after.formula_group_id == before.formula_group_id
    assert list(after.events) == []
    surge = batteries.stamp
    batteries.power['uav1'] = 240.0
    system.decided(future, FormulaResult.FALSE)
    assert 0 < nanoseconds(future.result().decided_at) - surge <= SECOND


def test_timeouts_pass_while_the_coordinator_is_stopped(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """They are answered before one that begins later, also for a request that came meanwhile."""
    before = system.ask(ALWAYS, timeout=6.0)
    evaluations.wait_for_state()
    with system.stopped('stream_reasoning_coordinator'):
        during = system.ask(ALWAYS, timeout=2.0)
        halt = batteries.stamp
        system.client.spin_until(lambda: batteries.stamp > halt + 7 * SECOND, 'seven seconds')
        assert not any(each.done() for each in (before, during))
    after = system.ask(ALWAYS, timeout=1.0)
    system.client.spin_until(after.done, 'the answer')
    assert before.done()
    assert during.done()
    for each in (before, during, after):
        assert each.result().exit_status.code == ExitStatus.TIMEOUT, each.result().exit_status
    assert_all_is_well(system)


@pytest.fixture
def far(system: System, tmp_path: Path) -> Iterator[Launcher]:
    """Another engine, in a namespace of its own, which will make the streams of states."""
    # That of a former one may be known still.
    namespace = f'far_{next(_numbers)}'
    # Otherwise it would make streams of the fleet, and the other engine would make the states.
    system.wait_for_streams()
    with Launcher(tmp_path, namespace=namespace, environment=system.environment) as launcher:
        launcher.start(Process('dyknow_stream_processing', ENGINE))
        system.client.spin_until(
            lambda: f'/{namespace}/{ENGINE}' in system.engines(), 'the other engine is known'
        )
        yield launcher
    system.client.spin_until(
        lambda: f'/{namespace}/{ENGINE}' not in system.engines(), 'the other engine is gone'
    )


def ask_for_far_states(system: System, evaluations: Evaluations, formula: str) -> tuple[Any, Any]:
    """The future of an answer, and what is told of the evaluation once it has had a state."""
    future = system.ask(formula, timeout=60.0)
    (told,) = evaluations.wait_for_state()
    assert told.state_stream.startswith('/far_')
    return future, told


def assert_goes_on(
    system: System, batteries: Batteries, evaluations: Evaluations, future: Any, before: Any
) -> None:
    """The formula that is evaluated is still the same one, and its violation is seen."""
    (after,) = evaluations.wait_for(1)
    batteries.power['uav2'] = 240.0
    system.decided(future, FormulaResult.FALSE)
    assert after.formula_group_id == before.formula_group_id


def test_the_other_engine_takes_over(
    system: System, batteries: Batteries, evaluations: Evaluations, far: Launcher
) -> None:
    future, before = ask_for_far_states(system, evaluations, ALWAYS)
    far.kill(ENGINE)
    evaluations.wait_for_event('gone', 'states are made of')
    assert_goes_on(system, batteries, evaluations, future, before)


@pytest.mark.usefixtures('far')
def test_what_states_are_made_of_moves_to_their_engine(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """It may hear first that the other one is gone, or that it makes those streams itself now."""
    future, before = ask_for_far_states(system, evaluations, ALWAYS)
    with system.killed(ENGINE):
        evaluations.wait_for_event('may be missing')
        assert_goes_on(system, batteries, evaluations, future, before)


def surge_for_half_a_second(system: System, batteries: Batteries) -> None:
    """A battery of a vehicle gives too much power for a moment."""
    batteries.power['uav1'] = 240.0
    surge = batteries.stamp
    system.client.spin_until(lambda: batteries.stamp > surge + SECOND // 2, 'half a second')
    batteries.power['uav1'] = 100.0


def assert_nothing_is_known(system: System, evaluations: Evaluations, future: Any) -> None:
    """True if there was a surge."""
    status = system.client.result(future, 'the answer').exit_status
    assert status.code == ExitStatus.CONSTRAINT_VIOLATION, evaluations.told()
    assert 'missing' in status.message


def test_no_verdict_over_what_an_engine_took_along(
    system: System, batteries: Batteries, evaluations: Evaluations, far: Launcher
) -> None:
    """A surge while no engine makes states is not seen; nor is its absence taken for granted."""
    future, _ = ask_for_far_states(system, evaluations, 'always[0 s, 6 s] Power[uav1] < 150')
    far.kill(ENGINE)
    surge_for_half_a_second(system, batteries)
    assert_nothing_is_known(system, evaluations, future)


@pytest.mark.usefixtures('far')
def test_no_verdict_over_what_an_engine_missed_that_was_back_at_once(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """Before anybody has noticed that it was gone, its streams are where they were."""
    future, _ = ask_for_far_states(system, evaluations, 'always[0 s, 8 s] Power[uav1] < 150')
    with system.killed(ENGINE):
        surge_for_half_a_second(system, batteries)
    assert_nothing_is_known(system, evaluations, future)


def test_both_engines_die(system: System, evaluations: Evaluations, far: Launcher) -> None:
    future = system.ask(ALWAYS, timeout=60.0)
    evaluations.wait_for_state()
    far.kill(ENGINE)
    with system.killed(ENGINE):
        assert_unavailable(system, future, 'stream_processing_engine')
    assert_all_is_well(system)
