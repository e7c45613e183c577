"""The command `dyknow evaluate`: evaluates a formula with a running DyKnow."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from typing import Any, Final, cast

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from dyknow_bringup.errors import BringupError
from dyknow_bringup.ros.system_start import where_coordinators_are
from dyknow_common import (
    SECOND_NS,
    ExitCode,
    Verdict,
    add_utc_option,
    clock_time,
    duration_option,
    with_readable_times,
)
from dyknow_common.executables import ERROR, FALSE, SUCCESS, describe, interruptible
from dyknow_common.ros import start_ros
from dyknow_common.tables import json_document
from dyknow_configuration import warn_of_notes
from dyknow_coordinator import Answer, Grounding, Progress, StandingVerdicts
from dyknow_coordinator.ros import FormulaClient
from dyknow_reasoning import check_types, parse_formula

GROUNDINGS = {grounding.name.lower(): grounding for grounding in Grounding}

_EPISODE_TIMES: Final = ('begin', 'end', 'decided_at')

COORDINATOR_TIMEOUT_S = 10.0
"""Time to wait for the coordinator, which may just have been started."""


def evaluate(chosen: argparse.Namespace) -> int:
    """Evaluate one formula; the exit code is 0 for true, 1 for false and 2 for no verdict."""
    # What is wrong with the text alone is said at once, also if no system runs.
    check_types(parse_formula(chosen.formula), chosen.formula)
    warn_of_notes([chosen.formula])
    answer = _ask(chosen)
    if chosen.json:
        _print(json.dumps(_as_json(answer)))
    elif answer.error is None:
        verdict = answer.verdict.name.lower()
        at = '' if answer.decided_at is None else f' at {clock_time(answer.decided_at)}'
        _print(f'{verdict}{at}: {with_readable_times(answer.explanation)}')
        if answer.margin is not None:
            _print(f'margin: {answer.margin}')
    else:
        text = with_readable_times(f'{answer.error.code.name}: {answer.error}')
        print(text, file=sys.stderr)  # noqa: T201
    return {Verdict.TRUE: SUCCESS, Verdict.FALSE: FALSE}.get(answer.verdict, ERROR)


def _ask(chosen: argparse.Namespace) -> Answer:
    start_ros()
    node = Node('dyknow_evaluate', start_parameter_services=False)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        with interruptible(), FormulaClient(node, chosen.coordinator) as client:
            monitor = client.monitor(
                chosen.formula,
                on_feedback=_Feedback().show,
                every_state=chosen.every_state,
                timeout=chosen.timeout / SECOND_NS,
                grounding=GROUNDINGS[chosen.grounding],
                margin=chosen.margin,
                wait=COORDINATOR_TIMEOUT_S,
            )
            executor.spin_until_future_complete(monitor.outcome)
        answer = cast('Answer', monitor.outcome.result())
        if answer.error is None or answer.error.code is not ExitCode.UNAVAILABLE:
            return answer
        hint = where_coordinators_are(node, chosen.coordinator)
        return replace(answer, error=BringupError(f'{answer.error}{hint}', answer.error.code))
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


class _Feedback:
    """Tells on stderr that no state comes, once for each reason, and when episodes begin or end."""

    def __init__(self) -> None:
        self._reason = ''
        self._episodes = StandingVerdicts()

    def show(self, progress: Progress) -> None:
        """Print what is new."""
        if progress.episodes is not None:
            before, self._episodes = self._episodes, progress.episodes
            if change := progress.episodes.change(before):
                print(with_readable_times(change), file=sys.stderr, flush=True)  # noqa: T201
        if progress.waits_for not in {'', self._reason}:
            since = ' for a while' if progress.states_progressed else ''
            text = f'no state has come{since}: {progress.waits_for}'
            print(text, file=sys.stderr, flush=True)  # noqa: T201
        self._reason = progress.waits_for


def _as_json(answer: Answer) -> dict[str, Any]:
    code = ExitCode.SUCCESS if answer.error is None else answer.error.code
    episodes = answer.episodes
    return {
        'formula': answer.canonical_formula,
        'verdict': answer.verdict.name.lower(),
        'decided_at_ns': answer.decided_at,
        'explanation': answer.explanation,
        'margin': answer.margin and answer.margin.document,
        'exit_status': code.name,
        'message': '' if answer.error is None else answer.error.message,
        **({} if episodes is None else {'every_state': json_document(episodes, _EPISODE_TIMES)}),
    }


def _print(text: str) -> None:
    print(text, flush=True)  # noqa: T201 - this is a command


def add_evaluate_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=evaluate)
    describe(
        parser,
        'Evaluate a formula over the topics of the running system, from now on.',
        (
            """dyknow evaluate 'always[0 s, 5 s] "/uav1/battery".voltage > 10'""",
            "dyknow evaluate 'forall u in UAV: always Altitude[u] < 30' --timeout 60",
        ),
        '0 for true, 1 for false, 2 for no verdict',
    )
    parser.add_argument('formula', help="such as: 'forall u in UAV: always Altitude[u] < 30'")
    parser.add_argument(
        '--timeout',
        type=duration_option,
        default='60 s',
        help="to wait for the verdict, such as 30 or '500 ms' (default: 60 s)",
    )
    parser.add_argument(
        '--grounding',
        choices=GROUNDINGS,
        default='auto',
        help='names are fields of topics (syntactic) or features (semantic; default: auto)',
    )
    parser.add_argument('--coordinator', default='stream_reasoning_coordinator', metavar='NODE')
    parser.add_argument(
        '--margin',
        action='store_true',
        help='also compute how far the formula is from the change of its verdict',
    )
    parser.add_argument(
        '--every-state',
        action='store_true',
        help='ask the formula at every state until the timeout; exit code 1: it was false from one',
    )
    parser.add_argument('--json', action='store_true', help='print a line of JSON')
    add_utc_option(parser)
