"""Outcomes of formulas, compared with the expected ones."""

import pytest

from dyknow_bringup.demonstration import unexpected
from dyknow_bringup.monitored_formula import MonitoredFormula
from dyknow_bringup.simulation.scenario import Expectation
from dyknow_configuration import RequestedFormula

START = 100_000_000_000
SECOND = 1_000_000_000
WINDOW = (5 * SECOND, 7 * SECOND)


def monitored(outcome: str, after: float | None = None) -> MonitoredFormula:
    known_at = None if after is None else START + round(after * SECOND)
    return MonitoredFormula(RequestedFormula('f', 'p'), outcome, known_at)


def difference(found: MonitoredFormula, expectation: Expectation) -> str | None:
    return unexpected([found], {'p': expectation}, START).get('p')


@pytest.mark.parametrize('after', [5, 6.2, 7])
def test_the_right_verdict_in_time(after: float) -> None:
    assert difference(monitored('true', after), Expectation('true', WINDOW)) is None


def test_the_wrong_verdict() -> None:
    problem = difference(monitored('false', 6), Expectation('true', WINDOW))
    assert problem == 'false instead of true'


@pytest.mark.parametrize('after', [4.9, 7.1])
def test_the_right_verdict_out_of_time(after: float) -> None:
    problem = difference(monitored('true', after), Expectation('true', WINDOW))
    assert problem == f'true at {after:.3f} s instead of between 5.000 s and 7.000 s'


def test_undecided_as_it_should_be() -> None:
    assert difference(monitored('undecided'), Expectation('undecided', None)) is None


def test_a_formula_without_an_expectation() -> None:
    assert unexpected([monitored('true', 1)], {}, START) == {}


def test_an_expectation_of_no_formula() -> None:
    problems = unexpected([monitored('true', 6)], {'q': Expectation('true', WINDOW)}, START)
    assert problems == {'q': 'no such formula instead of true'}
