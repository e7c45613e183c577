"""Relations of objects in space over time, as bars in pictures."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import SECOND_NS
from dyknow_recordings.evaluation.observation import SignalRecorder, StateSignals, terms_of
from dyknow_recordings.evaluation.results import FormulaReport
from dyknow_recordings.reporting.pictures.panels import held_spans, marks, panels
from dyknow_recordings.reporting.pictures.timeline import Span

DOMAINS = {'Robot': ('r1', 'r2'), 'Zone': ('dock',)}
OUT = 'forall r in Robot, z in Zone: always not distance[r, z] <= 0'
NUMBERS = st.sampled_from([-1.0, 0.0, 1.0, float('nan')])


def signals(formula: str, **columns: list[float | bool]) -> StateSignals:
    """The signals of states, one a second; names of features have underscores for brackets."""
    recorder = SignalRecorder(terms_of([formula], DOMAINS), DOMAINS)
    count = len(next(iter(columns.values())))
    named = {
        '{}[{}]'.format(*name.split('__')).replace('_to_', ', '): np.array(column)
        for name, column in columns.items()
    }
    recorder.states(np.arange(count) * SECOND_NS, named)
    return recorder.result()


def seconds(spans: tuple[Span, ...]) -> list[tuple[int, int]]:
    return [(each.start // SECOND_NS, each.end // SECOND_NS) for each in spans]


def test_a_bar_for_each_relation_that_held() -> None:
    known = signals(OUT, distance__r1_to_dock=[1, 0, -1, 1, -1], distance__r2_to_dock=[3.0] * 5)
    report = FormulaReport('out', OUT, signals=known)
    found = [each for each in panels(report)[0] if each.relations]
    assert [(each.relations, each.signals) for each in found] == [(('inside(r1, dock)',), ())]
    held = marks(report, Span(0, 5 * SECOND_NS)).held
    assert {name: seconds(each) for name, each in held.items()} == {
        'inside(r1, dock)': [(1, 3), (4, 4)]
    }


def test_relations_of_two_terms_and_their_names() -> None:
    formula = 'always (sight_distance[r1, r2] > 0 or position_x[r1] < position_x[r2])'
    known = signals(
        formula,
        sight_distance__r1_to_r2=[1.0, 1.0, -1.0],
        position_x__r1=[0.0, 5.0, 5.0],
        position_x__r2=[1.0, 1.0, 9.0],
    )
    found = {name: seconds(each) for name, each in held_spans(formula, known).items()}
    assert found == {
        'in_sight(r1, r2)': [(0, 2)],
        'position_x[r1] < position_x[r2]': [(0, 1), (2, 2)],
    }


def test_what_holds_along_links() -> None:
    links = 'over (Dist[a, b] <= 50 for a, b in Robot) from r1 to s: always somewhere[0, 9] Base[s]'
    known = signals(links, Base__r1=[True, False], Base__r2=[False, False])
    assert {name: seconds(each) for name, each in held_spans(links, known).items()} == {
        'Base[r1]': [(0, 1)]
    }
    plain = 'always Base[r1]'
    assert held_spans(plain, signals(plain, Base__r1=[True, True])) == {}, 'it has a line'


@given(st.lists(NUMBERS, min_size=1, max_size=9))
def test_spans_are_those_of_the_states(values: list[float]) -> None:
    known = signals(OUT, distance__r1_to_dock=values, distance__r2_to_dock=[1.0] * len(values))
    spans = held_spans(OUT, known).get('inside(r1, dock)', ())
    expected: list[tuple[int, int]] = []
    last = len(values) - 1
    for index, value in enumerate(values):
        if value <= 0 and (index == 0 or not values[index - 1] <= 0):
            others = (each for each in range(index, last) if not values[each] <= 0)
            expected.append((index, next(others, last)))
    assert seconds(spans) == expected


def test_other_formulas_have_no_relations() -> None:
    formula = 'forall r in Robot: always Power[r] < 3'
    known = signals(formula, Power__r1=[1.0], Power__r2=[2.0])
    assert held_spans(formula, known) == {}
