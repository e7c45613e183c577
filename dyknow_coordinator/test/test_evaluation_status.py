"""When an evaluation is a reason to worry."""

from dataclasses import replace

import pytest

from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    Level,
    SymbolGrounding,
    diagnose,
)
from dyknow_coordinator.reporting.evaluation_status import (
    Diagnosis,
    alarm_level,
    details,
    outcome,
)

SECOND = 1_000_000_000
NOW = 100 * SECOND
LIMIT = 5 * SECOND
RUNNING = EvaluationStatus(
    'ceiling',
    'always (Altitude[uav1] < 30)',
    EvaluationPhase.RUNNING,
    started=90 * SECOND,
    state_stream='/dyknow/streams/states_1',
    groundings=(
        SymbolGrounding('Altitude[uav1]', Grounding.SEMANTIC, 'select z from "a"', ('"b"', '"c"')),
    ),
    states_progressed=7,
    latest_valid_time=99 * SECOND,
    residual_formula='always (Altitude[uav1] < 30)',
)
ENDED = replace(
    RUNNING, phase=EvaluationPhase.ENDED, decided_at=98 * SECOND, explanation='31 m is not < 30'
)


def diagnosis(status: EvaluationStatus) -> Diagnosis:
    return diagnose(status, NOW, LIMIT)


def ended_with(code: ExitCode) -> EvaluationStatus:
    error = CoordinationError('why', code)
    return replace(ENDED, decided_at=None, explanation='', error=error)


def test_nothing_is_known_yet() -> None:
    assert diagnosis(RUNNING) == Diagnosis(Level.OK, 'undecided')
    assert outcome(RUNNING) == 'running'


def test_presumably_false() -> None:
    pending = replace(RUNNING, presumably_false=True)
    assert diagnosis(pending).level is Level.WARN
    assert diagnosis(pending).text.startswith('presumably false')
    assert outcome(pending) == 'presumably false'


@pytest.mark.parametrize('pending', [False, True])
@pytest.mark.parametrize('latest', [NOW - LIMIT - 1, None])
def test_silence(latest: int | None, *, pending: bool) -> None:
    silent = replace(RUNNING, latest_valid_time=latest, presumably_false=pending)
    assert diagnosis(silent).level is Level.WARN
    assert diagnosis(silent).text.startswith('no state has come for ')


def test_silence_begins_after_its_limit() -> None:
    assert diagnosis(replace(RUNNING, latest_valid_time=NOW - LIMIT)).level is Level.OK


def test_interrupted() -> None:
    interrupted = replace(
        RUNNING, phase=EvaluationPhase.INTERRUPTED, events=('first', 'stream "a" is gone')
    )
    assert diagnosis(interrupted) == Diagnosis(Level.WARN, 'interrupted: stream "a" is gone')
    assert diagnosis(replace(interrupted, events=())).level is Level.WARN


def test_grounding_takes_a_while() -> None:
    begun = EvaluationStatus('a', 'p', EvaluationPhase.GROUNDING, NOW - LIMIT)
    assert diagnosis(begun) == Diagnosis(Level.WARN, 'its streams are being found')
    waiting = replace(begun, phase=EvaluationPhase.RUNNING)
    assert diagnosis(waiting) == Diagnosis(Level.WARN, 'no state has come yet')
    slow = diagnosis(replace(begun, started=NOW - LIMIT - SECOND))
    assert slow == Diagnosis(Level.WARN, 'its streams have not been found within 6 s')


@pytest.mark.parametrize(
    ('verdict', 'level', 'text'),
    [
        (Verdict.TRUE, Level.OK, 'true: 31 m is not < 30'),
        (Verdict.FALSE, Level.ERROR, 'false: 31 m is not < 30'),
        (Verdict.UNDECIDED, Level.OK, 'undecided: 31 m is not < 30'),
    ],
)
def test_a_verdict(verdict: Verdict, level: Level, text: str) -> None:
    decided = replace(ENDED, verdict=verdict, presumably_false=True)
    assert diagnosis(decided) == Diagnosis(level, text)
    assert outcome(decided) == text.partition(':')[0]


@pytest.mark.parametrize(
    ('code', 'level'),
    [
        (ExitCode.CANCELLED, Level.OK),
        (ExitCode.TIMEOUT, Level.WARN),
        (ExitCode.NOT_FOUND, Level.ERROR),
        (ExitCode.UNAVAILABLE, Level.ERROR),
        (ExitCode.CONSTRAINT_VIOLATION, Level.ERROR),
        (ExitCode.INTERNAL_ERROR, Level.ERROR),
    ],
)
def test_an_end_without_a_verdict(code: ExitCode, level: Level) -> None:
    name = code.name.lower().replace('_', ' ')
    assert diagnosis(ended_with(code)) == Diagnosis(level, f'{name}: why')


def test_what_is_told_of_a_running_one() -> None:
    assert dict(details(RUNNING)) == {
        'formula': 'always (Altitude[uav1] < 30)',
        'phase': 'running',
        'verdict': 'undecided',
        'started': '90.000 s',
        'states': '7',
        'latest valid time': '9.000 s',
        'residual formula': 'always (Altitude[uav1] < 30)',
        'state stream': '/dyknow/streams/states_1',
        'streams': 'Altitude[uav1]: select z from "a"',
        'stand-ins': 'Altitude[uav1]: "b"\nAltitude[uav1]: "c"',
    }


def test_what_is_told_at_the_end() -> None:
    told = dict(details(replace(ENDED, plan='survey', action='land', verdict=Verdict.FALSE)))
    assert (told['verdict'], told['decided at']) == ('false', '8.000 s')
    assert (told['plan'], told['action']) == ('survey', 'land')
    assert told['explanation'] == '31 m is not < 30'
    assert dict(details(ended_with(ExitCode.NOT_FOUND)))['error'] == 'why'


def test_an_evaluation_without_states_is_waiting_and_says_for_what() -> None:
    waiting = replace(
        RUNNING,
        phase=EvaluationPhase.WAITING,
        latest_valid_time=None,
        waits_for='nobody publishes /odm',
    )
    assert diagnosis(waiting) == Diagnosis(Level.WARN, 'waiting for states: nobody publishes /odm')
    assert outcome(waiting) == 'waiting'
    assert dict(details(waiting))['waits for'] == 'nobody publishes /odm'


@pytest.mark.parametrize(
    ('status', 'monitored', 'asked'),
    [
        (replace(ENDED, verdict=Verdict.TRUE), Level.OK, Level.OK),
        (replace(ENDED, verdict=Verdict.FALSE), Level.WARN, Level.OK),
        (ended_with(ExitCode.CONSTRAINT_VIOLATION), Level.ERROR, Level.ERROR),
        (ended_with(ExitCode.UNAVAILABLE), Level.ERROR, Level.ERROR),
        (ended_with(ExitCode.NOT_FOUND), Level.WARN, Level.OK),
        (ended_with(ExitCode.TIMEOUT), Level.OK, Level.OK),
        (ended_with(ExitCode.CANCELLED), Level.OK, Level.OK),
    ],
)
def test_alarms_are_logged(status: EvaluationStatus, monitored: Level, asked: Level) -> None:
    assert alarm_level(status, is_monitored=True) is monitored
    assert alarm_level(status, is_monitored=False) is asked
