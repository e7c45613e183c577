"""Streams that would cost too much are refused before they are made."""

from __future__ import annotations

import pytest
from recorded_flow import Flow

from dyknow_common import LanguageError
from dyknow_stream_processing.dataflow import constraint_checks
from dyknow_stream_processing.language import term_sizes


def doubled(times: int, first: str = 'select x from "t"') -> str:
    """Merges of merges, each with twice the samples of the one before."""
    texts = [f'stream a{each} = merge(a{each - 1}, a{each - 1});' for each in range(1, times + 1)]
    return f'stream a0 = {first}; {"".join(texts)} sink a{times}'


@pytest.mark.parametrize('first', ['select x from "t"', 'sync("t", "u")', '"t"'])
def test_merges_that_double(flow: Flow, first: str) -> None:
    flow.create(doubled(6, first), 'few')
    for times in (7, 25, 60):
        with pytest.raises(LanguageError, match='repeat each sample of a stream more than 100'):
            flow.create(doubled(times, first), 'many')


def test_a_merge_of_many_topics_repeats_nothing(flow: Flow) -> None:
    topics = ', '.join(f'select x from "t{each}"' for each in range(200))
    flow.create(f'merge({topics})')


def test_a_sync_of_thousands(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(term_sizes, 'MAX_PARTS', 201)
    inputs = [f'select x as x{each} from "t{each}"' for each in range(101)]
    flow.create(f'sync({", ".join(inputs[:100])})', 'small')
    with pytest.raises(LanguageError, match='more than 201 parts, with all streams that it is'):
        flow.create(f'sync({", ".join(inputs)})', 'large')


def test_an_operator_of_many_inputs(flow: Flow) -> None:
    inputs = [f'select x as x{each} from "t{each}"' for each in range(term_sizes.MAX_INPUTS + 1)]
    flow.create(f'sync({", ".join(inputs[1:])})', 'small')
    with pytest.raises(LanguageError, match='a merge, sync or unit has 1001 inputs, more than'):
        flow.create(f'select x0 from sync({", ".join(inputs)})', 'large')


def test_a_stream_of_many_fields(flow: Flow) -> None:
    selections = [f'x as x{each}' for each in range(term_sizes.MAX_FIELDS + 1)]
    flow.create(f'select {", ".join(selections[1:])} from "t"', 'small')
    with pytest.raises(LanguageError, match='has 10001 fields; at most 10000 are possible'):
        flow.create(f'select {", ".join(selections)} from "t"', 'large')


def test_samples_that_wait_to_be_put_in_order(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constraint_checks, 'MAX_HELD', 3)
    flow.create('select x from "t" with max_delay = 1 h')
    flow.feed('t', range(5))
    assert flow.drops == {'buffer': 2}
    assert [each.constraint for each in flow.violations] == ['buffer'] * 2
    assert 'give a shorter max_delay' in flow.violations[0].message
