"""Fixtures of the system tests, and how all tests are distributed over processes.

`pytest -n 6` runs six processes. Each runs one unit of tests after the other, the longest first: a
group of modules that share one running system, a module, or a single test. System tests wait most
of the time, the tests of packages compute. So every third process runs the tests of packages, with
a low priority, while the others run the system tests.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from collections.abc import Generator, Iterator

from browser import Browser, missing_programs, open_browser
from dashboards import dashboard
from evaluations import Evaluations, Spares
from fork_server import ForkingPopen
from stream_nodes import StreamNodes
from system import Batteries, Client, SharedSystem, System, private_environment

FOLDER = Path(__file__).parent

SCHEDULE = (
    (
        'test_grounding_answers',
        'test_evaluate_formula',
        'test_shared_states',
        'test_monitor_formula',
        'test_cancel_evaluation',
        'test_margins',
        'test_probabilities',
        'test_verdict_topics',
        'test_monitor_plan',
        'test_behaviour_trees',
        'test_plain_client',
        # Its last test kills a node.
        'test_formula_client',
    ),
    ('test_hung_nodes', 'test_failures'),
    ('test_stand_ins', 'test_change', 'test_every_state'),
    ('test_black_boxes',),
    ('test_dashboard',),
    ('test_callers',),
    ('test_forged_messages',),
    ('test_triggers_in_use',),
    ('test_demonstration',),
    ('test_two_robots',),
    ('test_sim_time_jumps',),
    ('test_federation',),
    ('test_guard',),
    ('test_guard_systems',),
    ('test_guard_errors',),
    ('test_stopping',),
    ('test_tutorial',),
    ('test_examples',),
    ('test_rover',),
    ('test_quick_start',),
    ('test_robot_file',),
    ('test_up',),
    ('test_up_ends',),
    ('test_policies_in_use',),
    ('test_many_engines',),
    ('test_stream_conflicts',),
    ('test_replay_command',),
    ('test_recordings_as_live',),
    ('test_missing_samples',),
    ('test_watchdog',),
    ('test_trigger_targets',),
    ('test_built_in_sources',),
    ('test_exit_codes',),
    ('test_triggers',),
    ('test_guard_publishers',),
    ('test_observed_robot',),
    ('test_semantic_limits',),
    ('test_services',),
    ('test_typed_sinks',),
    ('test_streams_command',),
    ('test_semantic_stores',),
    ('test_reasoners',),
)
"""Units of modules, the slowest first. All modules of a unit run in one process, in this order."""

OF_INDEPENDENT_TESTS = {
    'test_demonstration',
    'test_examples',
    'test_launch_files',
    'test_many_engines',
    'test_replay_command',
    'test_stopping',
    'test_stream_conflicts',
    'test_up',
    'test_up_ends',
}
"""Modules whose tests share nothing: each test is a unit."""

IN_BOTH_COMPOSITIONS = {'test_change'}
"""Modules that run with a process for each node, and with one process for all of them."""

IN_PROCESSES = {
    'test_failures',
    'test_forged_messages',
    'test_formula_client',
    'test_guard',
    'test_hung_nodes',
}
"""Modules that stop or kill single nodes. For the others, one process has all nodes."""

OF_PROCESSES = {
    'test_exit_codes',
    'test_launch_files',
    'test_stopping',
    'test_up_ends',
    'test_watchdog',
}
"""Modules about the start and the end of processes, or that find them by /proc: none is forked."""

SHARED_SYSTEM = pytest.StashKey[SharedSystem]()

LOW_PRIORITY = 10
"""The nice value of processes that run the tests of packages."""

LOGGED_LINES = 100
"""The lines of the log of each process that are shown beside a failure."""


def is_system_test(test: str) -> bool:
    """Return True if a test, given its node id, is in this folder."""
    return Path(test.partition('::')[0]).parent.name == FOLDER.name


def runs_packages_first(worker: str) -> bool:
    """Return True if a process runs the tests of packages before system tests: `gw2`, `gw5`."""
    return int(worker.removeprefix('gw')) % 3 == 2


def unit_of(test: str) -> str:
    """Return the name of the unit of a test, given its node id."""
    path = Path(test.partition('::')[0])
    if not is_system_test(test):
        return str(path)
    if path.stem in OF_INDEPENDENT_TESTS:
        return test
    modules = next((modules for modules in SCHEDULE if path.stem in modules), (path.name,))
    return str(path.with_name(' '.join(modules)))


def pytest_configure(config: pytest.Config) -> None:
    """Start executables fast, and leave the processor to the nodes of system tests."""
    subprocess.Popen = ForkingPopen  # type: ignore[misc]
    if hasattr(config, 'workerinput') and runs_packages_first(config.workerinput['workerid']):
        os.nice(LOW_PRIORITY)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Run the system tests in the order of the schedule, in parallel runs before all others."""
    scheduled = [module for modules in SCHEDULE for module in modules]
    others = len(scheduled) + 1 if hasattr(config, 'workerinput') else -1

    def rank(item: pytest.Item) -> int:
        if item.path.parent != FOLDER:
            return others
        return scheduled.index(item.path.stem) if item.path.stem in scheduled else len(scheduled)

    items.sort(key=rank)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each process of pytest-xdist one unit after the other."""
    from xdist.scheduler import LoadScopeScheduling  # noqa: PLC0415 - only where it is installed

    class UnitScheduling(LoadScopeScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            return unit_of(nodeid)

        def _assign_work_unit(self, node: Any) -> None:
            if runs_packages_first(node.gateway.id):
                of_packages = (unit for unit in self.workqueue if not is_system_test(unit))
                first = next(of_packages, next(iter(self.workqueue)))
                self.workqueue.move_to_end(first, last=False)
            super()._assign_work_unit(node)

    config.option.loadscopereorder = False
    return UnitScheduling(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Stop the shared system with the last test of its unit."""
    yield
    shared = item.config.stash.get(SHARED_SYSTEM, None)
    if shared and (nextitem is None or unit_of(nextitem.nodeid) != unit_of(item.nodeid)):
        shared.stop()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Show the end of what the nodes have logged beside a failure."""
    report = yield
    if report.failed and item.path.parent == FOLDER:
        shared = item.config.stash.get(SHARED_SYSTEM, None)
        folders = [shared.folder if shared else None, item.funcargs.get('tmp_path')]
        for log in (log for folder in filter(None, folders) for log in folder.rglob('*.log')):
            lines = log.read_text(encoding='utf-8', errors='replace').splitlines()
            report.sections.append((str(log), '\n'.join(lines[-LOGGED_LINES:])))
    return report


@pytest.fixture(autouse=True, scope='module')
def _processes_are_forked(request: pytest.FixtureRequest) -> Iterator[None]:
    ForkingPopen.is_enabled = request.path.stem not in OF_PROCESSES
    yield
    ForkingPopen.is_enabled = False


@pytest.fixture(scope='session')
def shared_system(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> SharedSystem:
    shared = SharedSystem(tmp_path_factory.mktemp)
    request.config.stash[SHARED_SYSTEM] = shared
    return shared


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of some modules in both compositions."""
    if (
        metafunc.definition.path.stem in IN_BOTH_COMPOSITIONS
        and 'composition' in metafunc.fixturenames
    ):
        metafunc.parametrize(
            'composition',
            [False, True],
            ids=['processes', 'one_process'],
            scope='module',
            indirect=True,
        )


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[StreamNodes]:
    """The nodes of streams alone; the test starts them."""
    with StreamNodes(tmp_path) as running:
        yield running


@pytest.fixture(scope='module')
def composition(request: pytest.FixtureRequest) -> bool:
    """True if one process has all nodes."""
    return getattr(request, 'param', request.path.stem not in IN_PROCESSES)


@pytest.fixture(scope='module')
def system(shared_system: SharedSystem, composition: bool) -> System:  # noqa: FBT001 - a fixture
    """DyKnow for two vehicles, shared by the modules of a unit."""
    return shared_system.get(composition=composition)


@pytest.fixture(scope='module')
def served(shared_system: SharedSystem) -> Iterator[tuple[System, str]]:
    """A running system whose nodes may be killed, and the address of its live page."""
    system = shared_system.get(composition=False)
    with dashboard(system.environment) as address:
        system.batteries.reset()
        yield system, address


@pytest.fixture
def batteries(system: System) -> Batteries:
    """The telemetry of the vehicles: regular, and 100 W everywhere, when the test begins."""
    system.batteries.reset()
    return system.batteries


@pytest.fixture(scope='module')
def evaluations(system: System) -> Iterator[Evaluations]:
    """The coordinator's reports on all evaluations."""
    with closing(Evaluations(system)) as heard:
        yield heard


@pytest.fixture
def spares(system: System) -> Iterator[Spares]:
    """Streams that a test makes beside the fleet's, and their annotations."""
    made = Spares(system)
    yield made
    made.clear()


@pytest.fixture
def calm(batteries: Batteries, evaluations: Evaluations) -> Iterator[Batteries]:
    """The test begins with regular telemetry, and leaves no evaluation behind."""
    yield batteries
    evaluations.wait_for_nothing()


@pytest.fixture
def environment() -> dict[str, str]:
    """The variables of processes in a private domain."""
    return private_environment()


@pytest.fixture
def client(environment: dict[str, str]) -> Iterator[Client]:
    """A node in a private domain of its own, or in that of the test's processes."""
    with closing(Client(environment)) as alone:
        yield alone


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    """Headless Chromium; the tests are skipped where it is missing."""
    if missing := missing_programs():
        pytest.skip(f'this machine has no {" and no ".join(missing)}')
    with open_browser() as opened:
        yield opened
