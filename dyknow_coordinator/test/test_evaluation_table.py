"""Evaluations on a terminal."""

import json
from dataclasses import replace

from rich.console import Console, RenderableType

from dyknow_common import ExitCode, Margin, StandingVerdicts, Verdict, ViolationEpisode
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    SymbolGrounding,
)
from dyknow_coordinator.reporting.evaluation_table import (
    as_json,
    evaluation_details,
    evaluation_table,
)

SECOND = 1_000_000_000
RUNNING = EvaluationStatus(
    'power',
    'always (Power[uav1] < 200)',
    EvaluationPhase.RUNNING,
    started=10 * SECOND,
    groundings=(
        SymbolGrounding('Power[uav1]', Grounding.SEMANTIC, 'select a from "b"', ('"c"',)),
        SymbolGrounding('Power[uav2]', Grounding.SEMANTIC, 'select a from "b"'),
    ),
    states_progressed=12,
    latest_valid_time=12 * SECOND,
)
FALSE = replace(
    RUNNING,
    phase=EvaluationPhase.ENDED,
    verdict=Verdict.FALSE,
    decided_at=12 * SECOND,
    explanation='Power[uav1] = 231.4 is not < 200',
)
FAILED = replace(
    RUNNING,
    name='p',
    formula='p',
    phase=EvaluationPhase.ENDED,
    error=CoordinationError('no stream carries p\nat all', ExitCode.NOT_FOUND),
)


def shown(what: RenderableType) -> list[str]:
    """The lines without the space between columns."""
    console = Console(width=160)
    with console.capture() as captured:
        console.print(what)
    return [' '.join(line.split()) for line in captured.get().splitlines()]


def test_a_line_for_each_evaluation() -> None:
    pending = replace(RUNNING, presumably_false=True)
    moved = replace(RUNNING, phase=EvaluationPhase.INTERRUPTED, events=('stream b is gone',))
    now = int(12.5 * SECOND)
    assert shown(evaluation_table([RUNNING, pending, moved, FALSE, FAILED], now)) == [
        'evaluation state states streams since formula',
        'power running 12 1 2.5 s always (Power[uav1] < 200)',
        'power presumably false 12 1 2.5 s always (Power[uav1] < 200)',
        'power interrupted 12 1 2.5 s always (Power[uav1] < 200) stream b is gone',
        'power false 12 1 2.5 s always (Power[uav1] < 200) Power[uav1] = 231.4 is not < 200',
        'p not found 12 1 2.5 s no stream carries p',
    ]


def test_a_formula_is_shown_as_it_was_written() -> None:
    canonical = 'let Power: "W" in (always (Power[uav1] < 200 "W"))'
    status = replace(RUNNING, formula=canonical, formula_text='always Power[uav1] < 200 W')
    assert 'always Power[uav1] < 200 W' in shown(evaluation_table([status], SECOND))[1]
    assert 'formula always Power[uav1] < 200 W' in shown(evaluation_details([status]))


def test_that_there_is_none() -> None:
    assert shown(evaluation_table([], 0))[-1] == 'nothing is being evaluated'


def test_everything_about_an_evaluation() -> None:
    assert shown(evaluation_details([FALSE])) == [
        'evaluation power',
        'state false',
        'formula always (Power[uav1] < 200)',
        'phase ended',
        'verdict false',
        'decided at 2.000 s',
        'explanation Power[uav1] = 231.4 is not < 200',
        'started 10.000 s',
        'states 12',
        'latest valid time 2.000 s',
        'streams Power[uav1]: select a from "b"',
        'Power[uav2]: select a from "b"',
        'stand-ins Power[uav1]: "c"',
        '',
    ]


def test_an_evaluation_for_programs() -> None:
    told = json.loads(json.dumps(as_json(FALSE)))
    assert (told['phase'], told['verdict']) == ('ENDED', 'FALSE')
    assert (told['started_ns'], told['decided_at_ns']) == (10 * SECOND, 12 * SECOND)
    assert (told['exit_status'], told['message']) == ('SUCCESS', '')
    assert told['groundings'][0] == {
        'symbol': 'Power[uav1]',
        'grounding': 'SEMANTIC',
        'stream': 'select a from "b"',
        'stand_ins': ['"c"'],
    }
    failed = as_json(FAILED)
    assert failed['exit_status'] == 'NOT_FOUND'
    assert failed['message'].startswith('no stream carries p')
    assert failed['decided_at_ns'] is None


def test_margins_without_bounds_are_texts_as_json_has_no_infinite_numbers() -> None:
    """The margin of an episode was written as -Infinity."""
    episode = ViolationEpisode(1, 2, 2, 1, True, 'too late', Margin())
    episodes = StandingVerdicts(fails=1, episode_count=1, latest_episodes=(episode,))
    told = json.loads(json.dumps(as_json(replace(RUNNING, episodes=episodes)), allow_nan=False))
    (found,) = told['episodes']['latest_episodes']
    assert (found['worst']['lower'], found['worst']['upper']) == ('-inf', 'inf')


def test_a_waiting_evaluation_says_for_what() -> None:
    waiting = replace(RUNNING, phase=EvaluationPhase.WAITING, waits_for='nobody publishes /odm')
    (line,) = shown(evaluation_table([waiting], 13 * SECOND))[1:]
    assert line == 'power waiting 12 1 3 s always (Power[uav1] < 200) nobody publishes /odm'
    document = as_json(waiting)
    assert (document['phase'], document['waits_for']) == ('WAITING', 'nobody publishes /odm')
