"""The evaluations command, as people run it."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from select import select
from typing import Any

import pytest
from dyknow_interfaces.msg import EvaluationStatusArray

from commands import command, started
from dyknow_common import Verdict
from dyknow_common.ros import LATCHED
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, Grounding, SymbolGrounding
from reporter import COORDINATOR, Reporter
from system import LIMIT

GROUNDING = SymbolGrounding('p', Grounding.SEMANTIC, 'select a as p from b', ('select c as p',))


@pytest.fixture(scope='module')
def reporter() -> Iterator[Reporter]:
    """A coordinator with an evaluation that runs and one that looks for its streams."""
    telling = Reporter()
    now = telling.now()
    telling.tell(
        EvaluationStatus(
            'power',
            'always p',
            EvaluationPhase.RUNNING,
            started=now,
            groundings=(GROUNDING,),
            states_progressed=17,
        ),
        EvaluationStatus('eventually q', 'eventually q', EvaluationPhase.GROUNDING, started=now),
    )
    yield telling
    telling.close()


def start(reporter: Reporter, *arguments: str) -> Any:
    line = command('evaluations', *arguments)
    return started(line, {**reporter.environment, 'COLUMNS': '160'}, stderr=subprocess.PIPE)


def evaluations(reporter: Reporter, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs the command while the coordinator tells."""
    return ended(reporter, start(reporter, *arguments))


def ended(reporter: Reporter, running: Any) -> subprocess.CompletedProcess[str]:
    """Wait for the end of the command."""
    reporter.until(lambda: running.poll() is not None, 'the command ends')
    out, err = running.communicate(timeout=LIMIT)
    return subprocess.CompletedProcess(running.args, running.returncode, out, err)


def test_a_line_for_each_evaluation(reporter: Reporter) -> None:
    shown = evaluations(reporter)
    assert shown.returncode == 0, shown.stderr
    _, power, other = shown.stdout.splitlines()
    assert power.split()[:4] == ['power', 'running', '17', '1']
    assert power.rstrip().endswith('always p')
    assert other.startswith('eventually q')
    assert 'grounding' in other


def test_a_report_that_was_latched_some_time_ago_is_not_shown(reporter: Reporter) -> None:
    """Observers receive ended evaluations, although the last change may be minutes old."""
    before = reporter.statuses
    last = replace(before[0], phase=EvaluationPhase.ENDED, verdict=Verdict.TRUE)
    reporter.tell(last)
    latched: list[EvaluationStatusArray] = []
    node = reporter.client.node
    subscription = node.create_subscription(
        EvaluationStatusArray, f'/{COORDINATOR}/evaluations', latched.append, LATCHED
    )
    reporter.until(
        lambda: bool(latched) and latched[-1].evaluations[0].phase == EvaluationPhase.ENDED,
        'the report is latched',
    )
    node.destroy_subscription(subscription)
    # Nothing is published from now on until the command listens.
    reporter.statuses = [replace(last, name='now')]
    shown = evaluations(reporter)
    reporter.statuses = before
    assert 'now' in shown.stdout, shown


def test_everything_about_an_evaluation(reporter: Reporter) -> None:
    shown = evaluations(reporter, 'power')
    assert shown.returncode == 0, shown.stderr
    assert 'p: select a as p from b' in shown.stdout
    assert 'p: select c as p' in shown.stdout
    assert 'eventually q' not in shown.stdout


def test_evaluations_for_programs(reporter: Reporter) -> None:
    told = json.loads(evaluations(reporter, '--json').stdout)['evaluations']
    assert [(each['name'], each['phase']) for each in told] == [
        ('power', 'RUNNING'),
        ('eventually q', 'GROUNDING'),
    ]
    assert json.loads(evaluations(reporter, '--json', 'power').stdout)['evaluations'] == told[:1]


def test_an_evaluation_that_is_not_there(reporter: Reporter) -> None:
    shown = evaluations(reporter, 'speed')
    assert shown.returncode == 2
    assert shown.stderr == (
        "evaluations: there is no evaluation 'speed' (there are: power, eventually q)\n"
    )


def test_a_coordinator_that_is_not_there(reporter: Reporter) -> None:
    copies = reporter.client.node.create_publisher(EvaluationStatusArray, '/coordinator/copies', 1)
    shown = evaluations(reporter, '--timeout', '5 s', '--node', 'nobody')
    reporter.client.node.destroy_publisher(copies)
    assert shown.returncode == 2
    assert 'no report of /nobody within 5 s, as no such node runs; ' in shown.stderr
    assert f'there are: /{COORDINATOR} (choose one by --node)' in shown.stderr


def test_watching_until_one_has_seen_enough(reporter: Reporter) -> None:
    running = start(reporter, '--watch', '--json')
    assert running.stdout is not None
    reporter.until(lambda: bool(select([running.stdout], [], [], 0)[0]), 'a report')
    first = running.stdout.readline()
    running.send_signal(signal.SIGINT)
    shown = ended(reporter, running)
    assert len(json.loads(first)['evaluations']) == 2
    assert (shown.returncode, shown.stderr) == (130, '')
