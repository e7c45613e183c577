"""The dyknow command: starts DyKnow for one's own robot, and asks it formulas."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from dyknow_bringup.demonstration.expectations import VERDICTS
from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import SystemConfiguration, dyknow_processes
from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Verdict, round_time
from dyknow_common.ros import duration
from dyknow_coordinator import Answer, Grounding
from dyknow_coordinator.ros import FormulaClient

GROUNDINGS = {grounding.name.lower(): grounding for grounding in Grounding}
CHECK_PERIOD = 0.5
PATIENCE = 10.0
"""Seconds to wait for the coordinator, which may just have been started."""


def up(chosen: argparse.Namespace) -> int:
    """Runs the seven nodes until SIGINT or SIGTERM, or until one of them ends."""
    for path in (*chosen.ontology, *chosen.annotations, *chosen.streams, *chosen.bridges):
        if not path.is_file():
            raise BringupError(f'there is no file {path}', ExitCode.NOT_FOUND)
    configuration = SystemConfiguration(
        tuple(path.resolve() for path in chosen.ontology),
        tuple(path.resolve() for path in chosen.annotations),
        tuple(path.resolve() for path in chosen.streams),
        tuple(path.resolve() for path in chosen.bridges),
        _folder(chosen.store),
        chosen.reasoner,
    )
    logs = chosen.logs or Path(tempfile.mkdtemp(prefix='dyknow_'))
    logs.mkdir(parents=True, exist_ok=True)
    signals = {signal.SIGINT, signal.SIGTERM}
    with Launcher(
        logs,
        namespace=chosen.namespace,
        use_sim_time=chosen.use_sim_time,
        log_level=chosen.log_level,
    ) as launcher:
        launcher.start_all(dyknow_processes(configuration))
        # Blocked after the start, for the nodes would inherit it; then waited for.
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)
        _say(f'DyKnow runs; logs are in {logs}; stop it with Ctrl-C')
        while signal.sigtimedwait(signals, CHECK_PERIOD) is None:
            for executable, code in launcher.ended().items():
                text = launcher.log(executable).read_text(errors='replace').strip()
                raise BringupError(
                    f'{executable} ended with exit code {code}:\n{text}', ExitCode.UNAVAILABLE
                )
    return 0


def evaluate(chosen: argparse.Namespace) -> int:
    """Asks one formula; the exit code is 0 for true, 1 for false and 2 for no verdict."""
    answer = _ask(chosen)
    if chosen.json:
        _say(json.dumps(_told(answer)))
    elif answer.error is None:
        decided_at = round_time(answer.decided_at or 0)
        _say(f'{VERDICTS[answer.verdict]} at {decided_at}: {answer.explanation}')
    else:
        print(f'{answer.error.code.name}: {answer.error}', file=sys.stderr)  # noqa: T201
    return {Verdict.TRUE: 0, Verdict.FALSE: 1}.get(answer.verdict, 2)


def _ask(chosen: argparse.Namespace) -> Answer:
    rclpy.init(args=sys.argv)
    node = Node('dyknow_evaluate')
    try:
        with FormulaClient(node, chosen.coordinator) as client:
            return client.evaluate_blocking(
                chosen.formula,
                timeout=chosen.timeout / SECOND_NS,
                grounding=GROUNDINGS[chosen.grounding],
                wait=PATIENCE,
            )
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _told(answer: Answer) -> dict[str, Any]:
    code = ExitCode.SUCCESS if answer.error is None else answer.error.code
    return {
        'formula': answer.canonical_formula,
        'verdict': VERDICTS[answer.verdict],
        'decided_at_ns': answer.decided_at,
        'explanation': answer.explanation,
        'exit_status': code.name,
        'message': '' if answer.error is None else answer.error.message,
    }


def _say(text: str) -> None:
    print(text, flush=True)  # noqa: T201 - this is a command


def _folder(path: Path | None) -> Path | None:
    if path is not None:
        path.mkdir(parents=True, exist_ok=True)
    return path and path.resolve()


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options on the command line."""
    parser = argparse.ArgumentParser(prog='dyknow', description=__doc__)
    commands = parser.add_subparsers(required=True, metavar='COMMAND')

    starting = commands.add_parser('up', help='start the seven nodes')
    starting.set_defaults(command=up)
    for name, what in (
        ('ontology', 'OWL files'),
        ('annotations', 'files in SSL'),
        ('streams', 'files in the stream language'),
        ('bridges', 'files of bridge rules between the ontologies'),
    ):
        starting.add_argument(
            f'--{name}', nargs='*', type=Path, default=[], metavar='FILE', help=what
        )
    starting.add_argument(
        '--store',
        type=Path,
        metavar='FOLDER',
        help='keeps what services change of ontology and annotations (default: nothing is kept)',
    )
    starting.add_argument(
        '--reasoner',
        default='',
        help='structural, hermit or pellet, the last two with Java (default: structural)',
    )
    starting.add_argument('--namespace', default='', help='of all nodes (default: none)')
    starting.add_argument('--use-sim-time', action='store_true', help='take time from /clock')
    starting.add_argument('--log-level', default='info', help='of all nodes (default: info)')
    starting.add_argument('--logs', type=Path, help='folder for the logs')

    asking = commands.add_parser(
        'evaluate', help='ask a formula; exit code 0: true, 1: false, 2: no verdict'
    )
    asking.set_defaults(command=evaluate)
    asking.add_argument('formula', help="such as: 'forall u in UAV: always Altitude[u] < 30'")
    asking.add_argument(
        '--timeout', type=duration, default='60 s', help="such as '500 ms' (default: 60 s)"
    )
    asking.add_argument('--grounding', choices=GROUNDINGS, default='auto')
    asking.add_argument('--coordinator', default='stream_reasoning_coordinator', metavar='NODE')
    asking.add_argument('--json', action='store_true', help='print a line of JSON')
    return parser.parse_args(arguments)


def main() -> int:
    """The executable dyknow."""
    chosen = options(remove_ros_args(sys.argv)[1:])
    try:
        return int(chosen.command(chosen))
    except DyKnowError as error:
        print(f'dyknow: {error}', file=sys.stderr)  # noqa: T201 - this is a command
        return 2
    except KeyboardInterrupt:
        return 130
