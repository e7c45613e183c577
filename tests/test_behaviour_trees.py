"""Behaviours of py_trees over formulas, ticked over real nodes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any, Self

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.trees import BehaviourTree

from commands import dyknow_up, output_of, running
from evaluations import Evaluations
from fake_robots import FOLDER, SIMULATE, Example
from system import Batteries, Client, System, private_environment

from behaviour_trees.formula_behaviours import (  # isort: skip - the folder of the examples
    FormulaGuard,
    FormulaHolds,
    WaitForVerdict,
    named_formulas,
)

POWER = 'always Power[uav1] < 200'
SOON_TRUE = 'always[0 s, 1 s] Power[uav1] < 200'


class Drive(Behaviour):
    """A child that runs until the test says otherwise."""

    def __init__(self) -> None:
        super().__init__('drive')
        self.next_status = Status.RUNNING
        self.ticks = 0
        self.ends: list[Status] = []

    def update(self) -> Status:
        self.ticks += 1
        self.feedback_message = 'driving'
        return self.next_status

    def terminate(self, new_status: Status) -> None:
        self.ends.append(new_status)


class Ticking:
    """A tree that a timer of the node ticks, as in py_trees_ros."""

    def __init__(self, client: Client, root: Behaviour) -> None:
        self.root = root
        self._client = client
        self._tree = BehaviourTree(root)

    def __enter__(self) -> Self:
        self._tree.setup(node=self._client.node)
        self._timer = self._client.node.create_timer(0.05, self._tree.tick)
        return self

    def __exit__(self, *_: object) -> None:
        self._client.node.destroy_timer(self._timer)
        self._tree.interrupt()
        self._tree.shutdown()

    def until(self, condition: Callable[[], bool], what: str) -> None:
        self._client.spin_until(
            condition, what, instead=lambda: (self.root.status, self.root.feedback_message)
        )

    def until_status(self, status: Status, of: Behaviour | None = None) -> str:
        """Tick until a behaviour has a status; return its feedback message."""
        behaviour = of or self.root
        self.until(lambda: behaviour.status is status, f'{behaviour.name} is {status.name}')
        return str(behaviour.feedback_message)


@contextmanager
def guarded(client: Client, **formulas: str) -> Iterator[tuple[Ticking, Drive]]:
    """A guard over a child, whose states come."""
    drive = Drive()
    with Ticking(client, FormulaGuard('guard', drive, formulas)) as tree:
        tree.until_status(Status.RUNNING, drive)
        yield tree, drive


@pytest.fixture
def client(system: System) -> Client:
    return system.client


@pytest.mark.parametrize(
    ('formula', 'status', 'words'),
    [
        (SOON_TRUE, Status.SUCCESS, ''),
        ('always Power[uav1] < 50', Status.FAILURE, 'Power[uav1] = 100'),
        ('always Pwer[uav1] < 50', Status.FAILURE, "'Pwer'"),
    ],
)
@pytest.mark.usefixtures('calm')
def test_waiting_for_a_verdict(client: Client, formula: str, status: Status, words: str) -> None:
    seen = []
    with Ticking(client, WaitForVerdict('power', formula)) as tree:
        tree.until(lambda: seen.append(tree.root.status) or tree.root.status is status, 'the end')
        assert words in tree.root.feedback_message
    assert Status.RUNNING in seen


@pytest.mark.usefixtures('calm')
def test_a_guard_interrupts_its_child_when_a_formula_is_false_and_can_run_again(
    client: Client, batteries: Batteries
) -> None:
    with guarded(client, power=POWER, other='always Power[uav2] < 200') as (tree, drive):
        assert tree.root.status is Status.RUNNING
        assert tree.root.feedback_message == 'driving'
        batteries.power['uav1'] = 231.0
        message = tree.until_status(Status.FAILURE)
        assert message.startswith('power: Power[uav1] = 231')
        assert drive.status is Status.INVALID
        assert drive.ends[-1] is Status.INVALID
        batteries.reset()
        drive.next_status = Status.SUCCESS
        tree.until_status(Status.SUCCESS)
        assert drive.ends[-1] is Status.SUCCESS


@pytest.mark.parametrize('status', [Status.SUCCESS, Status.FAILURE])
@pytest.mark.usefixtures('calm')
def test_a_guard_ends_as_its_child_does(client: Client, status: Status) -> None:
    with guarded(client, power=POWER, soon=SOON_TRUE) as (tree, drive):
        drive.next_status = status
        tree.until_status(status)


@pytest.mark.usefixtures('calm')
def test_a_branch_that_is_preempted_ends_its_evaluations(
    client: Client, evaluations: Evaluations
) -> None:
    drive, urgent = Drive(), Drive()
    urgent.next_status = Status.FAILURE
    guard = FormulaGuard('guard', drive, {'power': POWER})
    with Ticking(client, Selector('root', memory=False, children=[urgent, guard])) as tree:
        tree.until_status(Status.RUNNING, drive)
        evaluations.wait_for(1)
        urgent.next_status = Status.RUNNING
        tree.until_status(Status.INVALID, guard)
        assert drive.ends[-1] is Status.INVALID
        evaluations.wait_for_nothing()
        urgent.next_status = Status.FAILURE
        tree.until_status(Status.RUNNING, drive)


@pytest.mark.usefixtures('calm')
def test_a_condition_follows_the_episodes_also_after_a_restart_of_the_tree(
    client: Client, batteries: Batteries
) -> None:
    condition = FormulaHolds('low_power', 'Power[uav1] < 200')
    for _ in range(2):
        with Ticking(client, condition) as tree:
            tree.until_status(Status.RUNNING)
            tree.until_status(Status.SUCCESS)
            batteries.power['uav1'] = 231.0
            assert 'Power[uav1] = 231' in tree.until_status(Status.FAILURE)
            batteries.power['uav1'] = 100.0
            tree.until_status(Status.SUCCESS)


@pytest.mark.usefixtures('calm')
def test_a_condition_is_evaluated_anew_when_its_time_is_over(client: Client) -> None:
    with Ticking(client, FormulaHolds('low_power', 'Power[uav1] < 200', timeout=2.0)) as tree:
        for _ in range(2):
            tree.until_status(Status.SUCCESS)
            tree.until_status(Status.RUNNING)


@pytest.mark.usefixtures('calm')
def test_silence_is_no_success(client: Client, batteries: Batteries) -> None:
    condition = FormulaHolds('low_power', 'Power[uav1] < 200')
    with Ticking(client, condition) as tree:
        tree.until_status(Status.SUCCESS)
        batteries.silent.add('uav1')
        assert tree.until_status(Status.FAILURE)
        batteries.silent.clear()
        tree.until_status(Status.SUCCESS)


class TestWithoutCoordinator:
    """Nothing answers."""

    @pytest.fixture
    def client(self, environment: dict[str, str]) -> Iterator[Client]:
        with closing(Client(environment)) as alone:
            yield alone

    def test_waiting_fails(self, client: Client) -> None:
        with Ticking(client, WaitForVerdict('power', POWER, wait=0.5)) as tree:
            assert 'stream_reasoning_coordinator' in tree.until_status(Status.FAILURE)

    def test_a_guard_does_not_start_its_child(self, client: Client) -> None:
        drive = Drive()
        guard = FormulaGuard('guard', drive, {'power': POWER}, wait=0.5)
        with Ticking(client, guard) as tree:
            assert 'stream_reasoning_coordinator' in tree.until_status(Status.FAILURE)
        assert drive.ticks == 0

    def test_a_condition_fails(self, client: Client) -> None:
        with Ticking(client, FormulaHolds('low_power', 'true', wait=0.5)) as tree:
            assert 'stream_reasoning_coordinator' in tree.until_status(Status.FAILURE)


def test_a_tree_without_a_node_says_so() -> None:
    with pytest.raises(KeyError, match=r'WaitForVerdict/power needs a node: call setup\(node='):
        WaitForVerdict('power', POWER).setup()


def test_formulas_of_a_robot_by_name() -> None:
    formulas = named_formulas(Example('rover').configuration)
    assert formulas['distance'] == 'forall r in Rover: always Ahead[r] > 0.3 m'
    assert formulas['aisle'].startswith('let ')


@pytest.mark.parametrize(
    ('faults', 'code', 'words'),
    [
        ((), 0, 'is > 7.5'),
        (('--fault', 'collision'), 1, 'distance: for r = rover: Ahead[rover] = 0.25'),
    ],
)
def test_the_tree_of_the_rover(faults: tuple[str, ...], code: int, words: str) -> None:
    configuration = str(Example('rover').configuration)
    environment: dict[str, Any] = private_environment()
    with (
        dyknow_up(environment, configuration, '--no-monitor'),
        running([sys.executable, str(SIMULATE), 'rover', *faults], environment),
    ):
        line = [sys.executable, str(FOLDER / 'behaviour_trees' / 'deliver.py'), configuration]
        done = output_of(line, environment)
        # The rover may arrive between two faults, and a busy machine may give no verdict.
        while words not in done.stdout:
            done = output_of(line, environment)
    assert done.returncode == code, done.stdout + done.stderr
