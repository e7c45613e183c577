"""Comparison of the answers of a running system to a replay with those over the recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dyknow_interfaces.msg import EvaluationStatus

from commands import command, running
from dyknow_common import ExitCode
from dyknow_common.ros import time_to_nanoseconds
from dyknow_recordings import (
    MonitoringFiles,
    RequestedFormula,
    evaluate_recording,
    open_recording,
)
from evaluations import Evaluations
from system import System

DISCOVERY = '8'
"""Seconds within which the nodes have found the publishers of a replay, also on a busy machine."""


def compare(system: System, bag: Path, formulas: Sequence[str]) -> list[Any]:
    """Compare the answers of the running system to a replay with those over the recording.

    Return the answers.
    """
    evaluations = Evaluations(system)
    asked = [system.ask(formula, timeout=120.0) for formula in formulas]
    system.client.spin_until(
        lambda: (
            len(evaluations.running) == len(formulas)
            and all(each.phase != EvaluationStatus.GROUNDING for each in evaluations.running)
        ),
        'the states of all formulas',
        instead=evaluations.told,
    )
    with running(command('replay', str(bag), '--clock', '--delay', DISCOVERY), system.environment):
        system.client.spin_until(lambda: all(each.done() for each in asked), 'verdicts', 90.0)
    files = MonitoringFiles(
        system.configuration.ontologies,
        system.configuration.annotations,
        system.configuration.streams,
    )
    with open_recording(bag) as recording:
        report = evaluate_recording(recording, [RequestedFormula(each) for each in formulas], files)
    for formula, answer, found in zip(formulas, asked, report.formulas, strict=True):
        live = answer.result()
        (episode,) = found.episodes
        code, message = ExitCode.SUCCESS, ''
        if found.error is not None:
            code, message = found.error.code, found.error.message
        # How late a node has noticed a violation differs.
        assert (live.exit_status.code, live.exit_status.message.partition(' (')[0]) == (
            code,
            message.partition(' (')[0],
        ), (formula, live.exit_status.message, message)
        assert (live.verdict, time_to_nanoseconds(live.decided_at) or None, live.explanation) == (
            episode.verdict,
            episode.decided_at,
            episode.explanation,
        ), (formula, live.exit_status.message, message)
    return [each.result() for each in asked]
