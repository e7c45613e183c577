"""Comparisons of texts: their truth on all paths, their margins and explanations."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import begun, random_cases
from test_functions import NAMES, decided, results_on_all_paths

from dyknow_common import Verdict
from dyknow_reasoning import parse_formula

REFERENCES = {
    'contains': lambda text, part: text.find(part) >= 0,
    'does not contain': lambda text, part: text.find(part) < 0,
    'starts with': lambda text, part: text[: len(part)] == part,
    'does not start with': lambda text, part: text[: len(part)] != part,
}
TEXTS = st.text('ab"é', max_size=3)


@settings(max_examples=random_cases(20))
@given(
    st.sampled_from([*REFERENCES]),
    st.sampled_from(['A[{0}] {1} B[{0}]', 'not (A[{0}] {1} B[{0}])', 'A[{0}] {1} "a"']),
    st.lists(st.tuples(TEXTS, TEXTS), min_size=1, max_size=6),
)
def test_all_paths_agree_with_the_reference(
    comparison: str, form: str, values: list[tuple[str, str]]
) -> None:
    columns: dict[str, list[Any]] = {}
    for index, name in enumerate(NAMES):
        turned = values[index % len(values) :] + values[: index % len(values)]
        pairs = [(first, 'a' if '"a"' in form else second) for first, second in turned]
        columns[f'A[{name}]'] = [first for first, _ in pairs]
        columns[f'B[{name}]'] = [second for _, second in pairs]
        truths = [REFERENCES[comparison](*pair) is not form.startswith('not') for pair in pairs]
        columns[f'C[{name}]'] = truths
    texts = [f'always ({form.format(name, comparison)} <-> C[{name}])' for name in NAMES]
    assert results_on_all_paths(texts, columns) == [[]] * 4
    wrong = {
        **columns,
        **{f'C[{name}]': [not each for each in columns[f'C[{name}]']] for name in NAMES},
    }
    found = results_on_all_paths(texts, wrong)
    assert all(each == found[0] for each in found)
    assert [each.verdict for each in found[0]] == [Verdict.FALSE] * len(NAMES)


@pytest.mark.parametrize(
    ('text', 'canonical'),
    [
        ('m contains "A"', 'm contains "A"'),
        ('not m  starts\twith "A" and p', '(not (m starts with "A")) and p'),
        ('let word = "A" in m does not  contain word', 'm does not contain "A"'),
        ('"A B" contains m', '"A B" contains m'),
        ('contains < 3 and starts > does', '(contains < 3) and (starts > does)'),
        ('any("/d".status.name starts with "A")', 'any("/d".status.name starts with "A")'),
        ('"/d".a[k = "x"].b contains "A"', '"/d".a[k = "x"].b contains "A"'),
    ],
)
def test_canonical_texts(text: str, canonical: str) -> None:
    assert str(parse_formula(text)) == canonical
    assert parse_formula(canonical) == parse_formula(text)


@pytest.mark.parametrize(
    ('text', 'explanation'),
    [
        ('always m contains "B"', 'm = "AUTO" at 0.000 s does not contain "B"'),
        ('always not m starts with "A"', 'm = "AUTO" at 0.000 s starts with "A"'),
        ('eventually m does not contain "B"', 'm = "AUTO" at 0.000 s does not contain "B"'),
        ('"LAND" starts with m', '"LAND" at 0.000 s does not start with m = "AUTO"'),
    ],
)
def test_explanations(text: str, explanation: str) -> None:
    assert decided(text, m='AUTO').explanation.partition(' (')[0] == explanation


def test_constants_need_no_state() -> None:
    assert decided('"AB" contains "B" and "AB" does not start with "B"').decided_at is None


def test_margins_are_infinite() -> None:
    group, _ = begun('always m contains "A"', margin=True)
    (result,) = group.progress(0, {'m': 'B'})
    assert result.margin is not None
    assert (result.margin.lower, result.margin.upper) == (-float('inf'), -float('inf'))
