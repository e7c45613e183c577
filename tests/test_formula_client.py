"""FormulaClient, in every way that the callbacks of a node may be run."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from dyknow_interfaces.action import MonitorFormula
from rclpy.action import ActionClient
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_coordinator import Answer, Grounding, Progress
from dyknow_coordinator.ros import FormulaClient
from evaluations import COORDINATOR, Evaluations
from system import ALWAYS, NOTICED, SOON, Batteries, Client, System, spinning


@pytest.fixture(autouse=True)
def calm(request: pytest.FixtureRequest) -> None:
    """Every test of the system begins with regular telemetry, and with no evaluation left."""
    if 'batteries' in request.fixturenames:
        request.getfixturevalue('batteries')
        request.getfixturevalue('system').wait_for_streams()


@contextmanager
def asker_beside(client: Client) -> Iterator[Node]:
    """An ordinary node, that nobody spins yet."""
    node = Node('asker', context=client.context)
    yield node
    node.destroy_node()


@pytest.fixture
def asker(system: System, batteries: Batteries) -> Iterator[Node]:  # noqa: ARG001 - telemetry flows
    with asker_beside(system.client) as node:
        yield node


def single(node: Node) -> Any:
    return SingleThreadedExecutor(context=node.context)


def several(node: Node) -> Any:
    return MultiThreadedExecutor(3, context=node.context)


EXECUTORS = pytest.mark.parametrize('make_executor', [single, several])


@EXECUTORS
def test_a_callback_awaits_the_answer(system: System, asker: Node, make_executor: Any) -> None:
    answers: list[Answer] = []
    client = FormulaClient(asker)

    async def ask() -> None:
        # In the node's own group, whose callbacks exclude each other.
        timer.cancel()
        answers.append(await client.evaluate(SOON))
        answers.append(await client.evaluate('exists u in UAV: Power[u] > 150'))
        answers.append(await client.evaluate('1 < 2'))

    timer = asker.create_timer(0.01, ask)
    with spinning(asker, make_executor(asker)):
        system.client.spin_until(lambda: len(answers) == 3, 'three answers')
    client.close()
    true, false, known = answers
    assert (true.verdict, true.error) == (Verdict.TRUE, None)
    assert true.canonical_formula == 'forall u in UAV: (always[0 s, 500 ms] (Power[u] < 150))'
    assert true.decided_at is not None
    assert true.check() is true
    assert (false.verdict, false.error) == (Verdict.FALSE, None)
    assert (known.verdict, known.decided_at) == (Verdict.TRUE, None)


@pytest.mark.parametrize('spun', [None, single, several])
def test_a_thread_waits_for_the_answer(system: System, asker: Node, spun: Any) -> None:
    answers: list[Answer] = []
    client = FormulaClient(asker)
    thread = threading.Thread(target=lambda: answers.append(client.evaluate_blocking(SOON)))
    if spun is None:
        thread.start()
        system.client.spin_until(lambda: bool(answers), 'the answer')
    else:
        with spinning(asker, spun(asker)):
            thread.start()
            system.client.spin_until(lambda: bool(answers), 'the answer')
    thread.join()
    client.close()
    assert (answers[0].verdict, answers[0].error) == (Verdict.TRUE, None)


def test_to_wait_in_a_callback_of_the_only_thread_is_refused(system: System, asker: Node) -> None:
    raised: list[RuntimeError] = []

    def ask() -> None:
        timer.cancel()
        with pytest.raises(RuntimeError, match='await evaluate') as caught:
            client.evaluate_blocking(SOON)
        raised.append(caught.value)

    timer = asker.create_timer(0.01, ask)
    with FormulaClient(asker) as client, spinning(asker, single(asker)):
        system.client.spin_until(lambda: bool(raised), 'the refusal')


def test_an_answer_that_comes_while_its_request_is_sent(
    system: System, asker: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread takes it before rclpy has noted the request: where rclpy makes a future."""

    def slow_future() -> Future:
        time.sleep(0.3)
        return Future()

    monkeypatch.setattr('rclpy.action.client.Future', slow_future)
    answers: list[Answer] = []
    with FormulaClient(asker) as client, spinning(asker, several(asker)):
        client.monitor(SOON, on_verdict=answers.append)
        system.client.spin_until(lambda: bool(answers), 'the answer')
    assert answers[0].error is None
    assert answers[0].verdict is Verdict.TRUE


def test_a_callback_waits_in_one_of_several_threads(system: System, asker: Node) -> None:
    answers: list[Answer] = []

    def ask() -> None:
        timer.cancel()
        answers.append(client.evaluate_blocking(SOON))

    timer = asker.create_timer(0.01, ask)
    with FormulaClient(asker) as client, spinning(asker, several(asker)):
        system.client.spin_until(lambda: bool(answers), 'the answer')
    assert answers[0].verdict is Verdict.TRUE


@EXECUTORS
def test_a_monitor_tells_the_verdict(
    system: System, batteries: Batteries, asker: Node, make_executor: Any
) -> None:
    told: list[Answer] = []
    progress: list[Progress] = []
    client = FormulaClient(asker)
    # Before anybody spins the node.
    monitor = client.monitor(ALWAYS, on_verdict=told.append, on_feedback=progress.append)
    with spinning(asker, make_executor(asker)):
        system.client.spin_until(
            lambda: bool(progress) and progress[-1].states_progressed > 0, 'a state'
        )
        first = progress[-1]
        assert not monitor.outcome.done()
        batteries.power['uav2'] = 240.0
        system.client.spin_until(lambda: bool(told), 'the verdict')
    client.close()
    (answer,) = told
    assert monitor.outcome.result() is answer
    assert answer.verdict is Verdict.FALSE
    assert 'Power[uav2] = 24' in answer.explanation
    assert 'Power[uav1]' in first.residual_formula
    assert (answer.decided_at or 0) > first.latest_valid_time


def test_several_clients_of_one_process_know_that_the_coordinator_lives(
    system: System, asker: Node
) -> None:
    told: list[Answer] = []
    progress: list[Progress] = []
    with FormulaClient(asker) as one, FormulaClient(asker) as two, spinning(asker, single(asker)):
        one.monitor(ALWAYS, on_verdict=told.append)
        two.monitor(ALWAYS, on_verdict=told.append, on_feedback=progress.append)
        # Longer than they wait for a first sign of life.
        system.client.spin_until(lambda: duration(progress) > 5_000_000_000, 'five seconds')
        assert told == []


def duration(progress: list[Progress]) -> int:
    """Nanoseconds of the states that a formula was progressed over."""
    times = [each.latest_valid_time for each in progress if each.latest_valid_time]
    return times[-1] - times[0] if times else 0


def test_a_listener_may_be_async(system: System, asker: Node) -> None:
    told: list[Answer] = []
    client = FormulaClient(asker)

    async def ask_again(answer: Answer) -> None:
        told.extend([answer, await client.evaluate(SOON)])

    client.monitor(SOON, on_verdict=ask_again)
    with spinning(asker, single(asker)):
        system.client.spin_until(lambda: bool(told), 'two verdicts')
    client.close()
    assert [answer.verdict for answer in told] == [Verdict.TRUE, Verdict.TRUE]


def test_what_is_under_way_is_cancelled_when_the_client_is_closed(
    system: System, asker: Node
) -> None:
    progress: list[Progress] = []
    told: list[Answer] = []
    asked: list[Answer] = []
    client = FormulaClient(asker)

    async def ask() -> None:
        timer.cancel()
        asked.append(await client.evaluate(ALWAYS, timeout=30.0))

    timer = asker.create_timer(0.01, ask)
    with spinning(asker, single(asker)):
        client.monitor(ALWAYS, on_feedback=progress.append, on_verdict=told.append)
        system.client.spin_until(lambda: bool(progress), 'progress')
        client.close()
        client.close()
        asker.create_timer(0.01, lambda: None)  # Something must go on for the executor to go on.
        system.client.spin_until(lambda: bool(asked), 'the end of the question')
        late = client.monitor(ALWAYS)
        assert client.evaluate_blocking(SOON).error is not None
    for answer in (*told, *asked, late.outcome.result()):
        assert answer.error is not None
        assert answer.error.code is ExitCode.CANCELLED


def test_a_goal_that_is_accepted_after_the_client_is_closed_is_cancelled(
    system: System, asker: Node, evaluations: Evaluations
) -> None:
    spun = system.client
    spun.executor.add_node(asker)
    # While it has another client, the coordinator does not notice that one is gone.
    other = ActionClient(spun.node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
    client = FormulaClient(asker)
    first = client.monitor(SOON)
    spun.spin_until(first.outcome.done, 'a verdict')
    with system.stopped(COORDINATOR):
        monitor = client.monitor(ALWAYS, name='late', timeout=600.0)
        assert monitor.call is not None
        call = monitor.call.call
        spun.spin_until(lambda: call.is_unanswered, 'the goal is sent')
        client.close()
    assert error_of(monitor).code is ExitCode.CANCELLED
    spun.spin_until(
        lambda: bool(evaluations.ended('late')),
        'the end of the evaluation',
        instead=evaluations.told,
    )
    (status,) = evaluations.ended('late')
    assert status.exit_status.message == 'cancelled by the caller'
    evaluations.wait_for_nothing()
    other.destroy()
    spun.executor.remove_node(asker)


def error_of(monitor: Any) -> DyKnowError:
    """Why a monitor has no verdict."""
    error = monitor.outcome.result().error
    assert isinstance(error, DyKnowError)
    return error


@pytest.mark.parametrize(
    ('formula', 'options', 'code', 'words'),
    [
        ('always Power[uav1] <', {}, ExitCode.INVALID_ARGUMENT, '1:21'),
        ('  ', {}, ExitCode.INVALID_ARGUMENT, 'empty'),
        ('always Powr[uav1] < 150', {}, ExitCode.NOT_FOUND, 'Powr'),
        (SOON, {'timeout': 0.0}, ExitCode.INVALID_ARGUMENT, 'not above 0'),
        (SOON, {'grounding': Grounding.SYNTACTIC}, ExitCode.INVALID_ARGUMENT, 'names no stream'),
        (ALWAYS, {'timeout': 1.0}, ExitCode.TIMEOUT, '1 s'),
    ],
)
def test_what_has_no_verdict(
    system: System, asker: Node, formula: str, options: dict[str, Any], code: ExitCode, words: str
) -> None:
    with FormulaClient(asker) as client, spinning(asker, single(asker)):
        monitor = client.monitor(formula, **options)
        system.client.spin_until(monitor.outcome.done, 'the end')
        answers: list[Answer] = [monitor.outcome.result()]
        thread = threading.Thread(
            target=lambda: answers.append(client.evaluate_blocking(formula, **options))
        )
        thread.start()
        system.client.spin_until(lambda: len(answers) == 2, 'the answer')
        thread.join()
    for answer in answers:
        assert answer.verdict is Verdict.UNDECIDED
        with pytest.raises(DyKnowError, match=words) as caught:
            answer.check()
        assert caught.value.code is code


def test_a_formula_is_monitored_again_after_a_violation(
    system: System, batteries: Batteries, evaluations: Evaluations, asker: Node
) -> None:
    told: list[Answer] = []
    broken: list[Answer] = []
    vehicle = min(batteries.power)
    with FormulaClient(asker) as client, spinning(asker, single(asker)):
        client.monitor(ALWAYS, on_verdict=told.append, on_interruption=broken.append)
        evaluations.wait_for_state()
        batteries.silent.add(vehicle)
        system.client.spin_until(lambda: bool(broken), 'the interruption')
        batteries.silent.clear()
        evaluations.wait_for_state()
        assert not told
        batteries.power[vehicle] = 200.0
        system.client.spin_until(lambda: bool(told), 'the verdict')
    assert all(each.error for each in broken)
    assert broken[0].error is not None
    assert broken[0].error.code is ExitCode.CONSTRAINT_VIOLATION
    assert [each.verdict for each in told] == [Verdict.FALSE]


def test_without_a_coordinator(client: Client) -> None:
    with asker_beside(client) as node, FormulaClient(node) as asking:
        told: list[Answer] = [asking.evaluate_blocking(SOON, wait=0.5)]
        asking.monitor(SOON, on_verdict=told.append, wait=0.5)
        with spinning(node, single(node)):
            client.spin_until(lambda: len(told) == 2, 'the answers')
    for answer in told:
        assert answer.error is not None
        assert answer.error.code is ExitCode.UNAVAILABLE
        assert 'is not running, or was not found within 0.5 s' in answer.error.message


# The last test of the unit, as it kills a node.
def test_a_coordinator_that_dies_meanwhile(
    system: System, evaluations: Evaluations, asker: Node
) -> None:
    told: list[Answer] = []
    with FormulaClient(asker) as client, spinning(asker, single(asker)):
        client.monitor(ALWAYS, on_verdict=told.append)
        thread = threading.Thread(target=lambda: told.append(client.evaluate_blocking(ALWAYS)))
        thread.start()
        evaluations.wait_for(2)
        system.launcher.kill('stream_reasoning_coordinator')
        system.client.spin_until(lambda: len(told) == 2, 'the answers', NOTICED)
        thread.join()
        for answer in told:
            assert answer.error is not None
            assert answer.error.code is ExitCode.UNAVAILABLE
            assert 'has died or was stopped' in answer.error.message

        system.restart('stream_reasoning_coordinator')
        system.client.wait_for_coordinator()
        again = client.monitor('forall u in UAV: u = u')
        system.client.spin_until(again.outcome.done, 'the answer of the new one')
        assert again.outcome.result().verdict is Verdict.TRUE
