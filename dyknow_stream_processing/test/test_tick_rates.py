"""The limits of synchronisations with a period."""

from __future__ import annotations

import pytest

from dyknow_common import NO_CONSTRAINTS, DyKnowError, LanguageError, StreamConstraints
from dyknow_stream_processing import parse_specification
from dyknow_stream_processing.language.term_sizes import MAX_TICK_RATE, MAX_VALUE_RATE, check_rates


def sync(inputs: int, period_ns: int) -> str:
    sources = ', '.join(f'select x as x{each} from "/t"' for each in range(inputs))
    return f'sync({sources}) with sample_period = {period_ns} ns'


def check(text: str, constraints: StreamConstraints = NO_CONSTRAINTS) -> None:
    check_rates(parse_specification(text), constraints)


@pytest.mark.parametrize(('inputs', 'period_ns'), [(1, 100_000), (10, 100_000), (50, 500_000)])
def test_the_fastest_sync_is_accepted(inputs: int, period_ns: int) -> None:
    assert inputs * 10**9 // period_ns <= MAX_VALUE_RATE
    check(sync(inputs, period_ns))
    with pytest.raises(LanguageError, match=f'a sync of {inputs} inputs each .* is too fast'):
        check(sync(inputs, period_ns - 1))


def test_the_message_shows_the_place_and_the_limits() -> None:
    with pytest.raises(LanguageError) as caught:
        check(f'stream fast = {sync(2, 1)}; stream slow = select x0 from fast; sink slow')
    text = str(caught.value)
    assert f'{MAX_TICK_RATE} samples and {MAX_VALUE_RATE} values' in text
    assert text.startswith('stream specification:1:15: a sync of 2 inputs each 1 ns')


def test_a_period_that_is_requested_beside_the_text_counts_for_the_last_sync() -> None:
    fast = StreamConstraints(sample_period=1)
    plain = 'sync("/a", "/b")'
    check('select x from "/a"', fast)
    for text in (plain, f'stream s = {plain}; sink s', f'stream s = {plain}; stream t = s; sink t'):
        with pytest.raises(LanguageError, match='too fast'):
            check(text, fast)
    check(f'stream s = {plain}; sink select x from s', fast)


def test_a_period_that_no_stream_can_keep_is_not_called_fast() -> None:
    with pytest.raises(DyKnowError, match='sample_period is -5 ns; it must be more than 0'):
        check('sync("/a", "/b")', StreamConstraints(sample_period=-5))
