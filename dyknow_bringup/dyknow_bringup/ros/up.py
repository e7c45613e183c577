"""The command `dyknow up`: runs the seven nodes, restarts them, and shows their warnings."""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sized
from pathlib import Path

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace
from rich.console import Console
from rich.text import Text

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.arguments import for_any_namespace
from dyknow_bringup.processes.composition import composed, name_in, names_in
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.logs import LogReader, LogThrottle, log_folder
from dyknow_bringup.processes.processes import (
    Process,
    SystemConfiguration,
    dyknow_processes,
    watching_processes,
)
from dyknow_bringup.processes.robot import with_robot
from dyknow_bringup.processes.supervision import Supervisor
from dyknow_bringup.ros.system_start import SystemStart, wait_for_start
from dyknow_common import SECOND_NS, ExitCode, duration_option
from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import RequestedFormula, read_robot
from dyknow_coordinator import FOLLOWED
from dyknow_main import TERMINAL_SIGNALS, handle

PERIOD_S = 0.2
"""The period in which ended nodes and new warnings are noticed."""

UNENFORCED = (
    'ROS security is enabled but not enforced: nodes without keys run unsecured; set '
    'ROS_SECURITY_STRATEGY=Enforce'
)

INSTEAD_OF_ROS_ARGUMENTS = (
    'up starts several nodes; use its options --namespace, --use-sim-time, --log-level and '
    '--params-file, or nodes: of the robot.yaml, and write the names of topics in the robot.yaml'
)

_STYLES = {'WARN': 'yellow', 'ERROR': 'red', 'FATAL': 'red'}


class LogMonitor:
    """Shows the warnings and errors in the logs of processes on the terminal.

    Args:
        processes: the processes.
        log: returns the log of the process of a name; what it contains already is not shown.
        monitors: True if one of them monitors formulas and logs their outcomes: then outcomes in
            the log of the coordinator are not shown.
    """

    def __init__(
        self,
        processes: Iterable[Process],
        log: Callable[[str], Path],
        *,
        monitors: bool,
    ) -> None:
        self._readers = [(each, LogReader(log(each.name))) for each in processes]
        self._logs = {node: log(each.name) for each in processes for node in names_in(each)}
        self._monitors = monitors
        self._throttle = LogThrottle()
        self._console = Console(stderr=True)

    def show(self, level: str, text: str) -> None:
        """Show a message."""
        message = Text.assemble((f'{level} ', _STYLES[level]), text)
        self._console.print(message, soft_wrap=True)

    def update(self, now: int) -> None:
        """Show what is new."""
        for process, reader in self._readers:
            for record in reader.read():
                node = record.logger.removesuffix(f'.{FOLLOWED}')
                if self._monitors and node != record.logger:
                    continue
                name = name_in(process, node)
                if self._throttle.admit(name, record, now):
                    self.show(record.level, f'{name}: {record.text}')
        for name, count in self._throttle.left_out(now):
            self.show('WARN', f'{name}: {count} more warnings and errors are in {self._logs[name]}')


def up(chosen: argparse.Namespace) -> int:
    """Run the nodes until SIGINT, SIGTERM or SIGHUP, or until one of them cannot run."""
    namespace = _absolute(chosen.namespace)
    if chosen.wait:
        return _wait(namespace, chosen)
    stop, begin = threading.Event(), time.time_ns()
    handle(TERMINAL_SIGNALS, lambda *_: stop.set())
    nodes, processes, formulas = _processes(chosen)
    with (
        log_folder(chosen.logs) as logs,
        Launcher(
            logs,
            namespace=namespace,
            use_sim_time=chosen.use_sim_time,
            log_level=chosen.log_level,
        ) as launcher,
    ):
        monitor = LogMonitor(processes, launcher.log, monitors=bool(formulas))
        supervisor = Supervisor(
            launcher,
            processes,
            lambda text: monitor.show('WARN', text),
            restarts=not chosen.no_respawn,
        )
        if is_unenforced(os.environ):
            monitor.show('WARN', UNENFORCED)

        def update() -> None:
            now = time.monotonic_ns()
            monitor.update(now)
            supervisor.update(now)

        with SystemStart(namespace, [each.name for each in nodes], begin) as start:
            _await_start(start, chosen.timeout, stop, update)
        if not stop.is_set():
            print(_greeting(start, formulas, logs), flush=True)  # noqa: T201
        while not stop.wait(PERIOD_S):
            update()
    return SUCCESS


def _greeting(start: SystemStart, formulas: Sized, logs: Path) -> str:
    count = len(formulas)
    monitored = f'; monitors {count} formula{"s" * (count != 1)}' if count else ''
    return f'{start}{monitored}; logs are in {logs}; stop it with Ctrl-C'


def _processes(
    chosen: argparse.Namespace,
) -> tuple[tuple[Process, ...], tuple[Process, ...], tuple[RequestedFormula, ...]]:
    """Return the nodes of DyKnow, the processes that run and watch them, and formulas.

    The formulas are the monitored ones.
    """
    configuration = _configuration(chosen)
    nodes = dyknow_processes(configuration)
    joined = nodes if chosen.processes else composed(nodes, os.environ)
    path = configuration.monitored
    formulas = () if path is None else read_robot(path).formulas
    return nodes, (*joined, *watching_processes(configuration)), formulas


def _await_start(
    start: SystemStart, timeout: int, stop: threading.Event, update: Callable[[], None]
) -> None:
    end = time.monotonic() + timeout / SECOND_NS
    while not (stop.is_set() or start.is_complete or time.monotonic() > end):
        start.spin_once(PERIOD_S)
        update()


def _wait(namespace: str, chosen: argparse.Namespace) -> int:
    """Wait for a system that something else starts."""
    configuration = _configuration(chosen)
    if configuration != SystemConfiguration(engines=configuration.engines):
        raise BringupError(
            'with --wait, nothing is started: run "dyknow up" with the files in the background, '
            'then "dyknow up --wait" without them'
        )
    names = [process.name for process in dyknow_processes(configuration)]
    print(wait_for_start(namespace, names, chosen.timeout))  # noqa: T201 - this is a command
    return SUCCESS


def is_unenforced(environment: Mapping[str, str]) -> bool:
    """Return True if ROS security is enabled, and nodes that have no keys run all the same."""
    is_enabled = environment.get('ROS_SECURITY_ENABLE') == 'true'
    return is_enabled and environment.get('ROS_SECURITY_STRATEGY') != 'Enforce'


def _absolute(namespace: str) -> str:
    absolute = f'/{namespace.strip("/")}'
    try:
        validate_namespace(absolute)
    except InvalidNamespaceException as error:
        raise BringupError(str(error), ExitCode.INVALID_ARGUMENT) from None
    return absolute


def _configuration(chosen: argparse.Namespace) -> SystemConfiguration:
    if chosen.store is not None:
        chosen.store.mkdir(parents=True, exist_ok=True)
    files = SystemConfiguration(
        ontologies=tuple(path.resolve() for path in chosen.ontology),
        annotations=tuple(path.resolve() for path in chosen.annotations),
        streams=tuple(path.resolve() for path in chosen.streams),
        bridges=tuple(path.resolve() for path in chosen.bridges),
        store=chosen.store and chosen.store.resolve(),
        reasoner=chosen.reasoner,
        params_file=chosen.params_file and for_any_namespace(chosen.params_file.resolve()),
        engines=chosen.engines,
        recorder=chosen.record and {'folder': str(chosen.record.resolve())},
    )
    if chosen.robot is not None:
        return with_robot(files, chosen.robot, monitor=chosen.monitor)
    return files


def add_up_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=up, instead_of_ros_arguments=INSTEAD_OF_ROS_ARGUMENTS)
    describe(
        parser,
        'Start the nodes of DyKnow and the guards of a robot, monitor its formulas, and show '
        'warnings and errors of all nodes.',
        (
            'dyknow up robot.yaml',
            'dyknow up robot.yaml --no-monitor',
            'dyknow up --ontology robot.owl --annotations robot.ssl --streams robot.streams',
            'dyknow up --namespace /robot1 --use-sim-time',
            'dyknow up robot.yaml & dyknow up --wait && dyknow monitor robot.yaml',
        ),
        '0 after a stop by a signal, or with --wait if all nodes are ready; 2 for an error',
    )
    _add_files(parser)
    _add_settings(parser)
    parser.add_argument(
        '--monitor',
        action=argparse.BooleanOptionalAction,
        default=True,
        help='monitor the formulas of the robot.yaml, and run their triggers, as "dyknow monitor '
        'robot.yaml --retry" does (default: yes)',
    )
    parser.add_argument(
        '--no-respawn', action='store_true', help='end when a node dies (default: start it again)'
    )
    parser.add_argument(
        '--logs', type=Path, help='folder for the logs (default: one that an error alone leaves)'
    )
    parser.add_argument(
        '--wait', action='store_true', help='start nothing; wait until all nodes are ready'
    )
    parser.add_argument(
        '--timeout',
        type=duration_option,
        default='30 s',
        help='after which nodes are reported that are not ready (default: 30 s)',
    )


def _add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--store',
        type=Path,
        metavar='FOLDER',
        help='keeps changes of the ontology and of the annotations (default: nothing is kept)',
    )
    parser.add_argument(
        '--reasoner',
        default='',
        help='structural, hermit or pellet, the last two with Java (default: structural)',
    )
    parser.add_argument(
        '--processes',
        action='store_true',
        help='run each node in a process of its own (default: all in one)',
    )
    parser.add_argument(
        '--params-file',
        type=Path,
        metavar='FILE',
        help='ROS file of parameters of the nodes; it takes precedence over the others',
    )
    parser.add_argument(
        '--engines',
        type=int,
        default=1,
        metavar='N',
        help='number of stream processing engines (default: 1)',
    )
    parser.add_argument(
        '--record',
        type=Path,
        metavar='FOLDER',
        help='record black boxes into this folder (default: only if a formula of the robot.yaml '
        'asks for one, into ~/.ros/dyknow/black_boxes)',
    )
    parser.add_argument('--namespace', default='', help='of all nodes (default: none)')
    parser.add_argument('--use-sim-time', action='store_true', help='take time from /clock')
    parser.add_argument('--log-level', default='info', help='of all nodes (default: info)')


def _add_files(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('robot', nargs='?', type=Path, help='robot.yaml, which describes the robot')
    for name, description in (
        ('ontology', 'OWL files'),
        ('annotations', 'files in SSL'),
        ('streams', 'files in the stream language'),
        ('bridges', 'files of bridge rules between the ontologies'),
    ):
        parser.add_argument(
            f'--{name}', nargs='*', type=Path, default=[], metavar='FILE', help=description
        )
