"""Formulas that `dyknow monitor` shows, and its table on a terminal of 80 columns."""

from __future__ import annotations

import io
from contextlib import nullcontext
from dataclasses import replace

import pytest

from dyknow_bringup.errors import BringupError
from dyknow_bringup.monitored_formula import MonitoredFormula, formula_table, is_any_evaluated
from dyknow_common import SECOND_NS, DyKnowError, ExitCode, clock_time
from dyknow_common.tables import Terminal
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, StandingVerdicts, as_reported

START = 1_700_000_000 * SECOND_NS


def test_the_table_says_since_when_times_count() -> None:
    why = f'Speed[r1] = 3.0 at {START // SECOND_NS + 2}.500 s is not < 2 m/s (it must always hold)'
    failed = MonitoredFormula(
        RequestedFormula('always Speed[r1] < 2 m/s', 'speed'),
        outcome='false',
        known_at=START + 3 * SECOND_NS,
        explanation=why,
    )
    output = io.StringIO()
    Terminal(file=output, width=80).print(formula_table([failed], START, 9 * SECOND_NS))
    title, *lines = output.getvalue().splitlines()
    assert title.strip() == f'9.000 s since {clock_time(START)}'
    assert max(map(len, lines)) <= 80
    shown = ' '.join(output.getvalue().replace('│', ' ').split())
    assert 'speed false 3.000 s Speed[r1] = 3.0 at 2.500 s is not < 2 m/s' in shown


def test_no_caret_is_folded() -> None:
    fault = "formula:1:3: unknown unit 'warp'\n  x < 3 warp\n        ^"
    wrong = MonitoredFormula(RequestedFormula('x'), outcome='INVALID_ARGUMENT', explanation=fault)
    output = io.StringIO()
    Terminal(file=output, width=80).print(formula_table([wrong], START, 0))
    assert "unknown unit 'warp'" in output.getvalue()
    assert '^' not in output.getvalue()


@pytest.mark.parametrize(
    ('asked', 'phase', 'is_evaluated'),
    [
        (RequestedFormula('let m = 5 in\n x < m', 'lim', every_state=True), 'RUNNING', True),
        (RequestedFormula('x < m', 'lim', constants=(('m', 5),), every_state=True), 'ENDED', True),
        (RequestedFormula('x < m', 'lim', constants=(('m', 4),), every_state=True), 'ENDED', False),
        (
            RequestedFormula('x < m', 'lim', constants=(('m', 4),), every_state=True),
            'RUNNING',
            None,
        ),
        (RequestedFormula('let m = 5 in x < m', 'lim'), 'RUNNING', None),
        (RequestedFormula('x < 4', 'other'), 'RUNNING', False),
    ],
)
def test_no_other_formula_of_the_same_name_is_shown(
    *, asked: RequestedFormula, phase: str, is_evaluated: bool | None
) -> None:
    text = 'let m = 5 in x < m'
    running = EvaluationStatus(
        'lim',
        text,
        EvaluationPhase[phase],
        started=1,
        formula_text=text,
        episodes=StandingVerdicts(),
    )
    refused = pytest.raises(BringupError, match=f"'lim': .* another .*, {text} .at every state.;")
    with refused if is_evaluated is None else nullcontext():
        assert is_any_evaluated([MonitoredFormula(asked)], [running]) is is_evaluated


def test_what_a_client_has_cancelled_is_not_evaluated() -> None:
    ended = EvaluationStatus(
        'lim',
        'x < 5',
        EvaluationPhase.ENDED,
        started=1,
        formula_text='x < 5',
        error=DyKnowError('cancelled by the caller', ExitCode.CANCELLED),
    )
    asked = MonitoredFormula(RequestedFormula('x < 5', 'lim'))
    assert not is_any_evaluated([asked], [ended])
    violated = replace(ended, error=DyKnowError('/a is silent', ExitCode.CONSTRAINT_VIOLATION))
    assert is_any_evaluated([asked], [ended, replace(violated, started=2)])


def test_a_formula_whose_text_is_too_long_for_reports_is_found() -> None:
    text = ' and '.join(f'x{number} < 1' for number in range(2_000))
    asked = MonitoredFormula(RequestedFormula(text))
    told = [as_reported(each) for each in (asked.name, text)]
    status = EvaluationStatus(
        told[0], told[1], EvaluationPhase.RUNNING, started=1, formula_text=told[1]
    )
    assert status.name != asked.name
    assert is_any_evaluated([asked], [status])
