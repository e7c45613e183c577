"""The stream specifications of section III of the paper: its grammar and its figures 2 to 4."""

from __future__ import annotations

import pytest

from dyknow_common import LanguageError
from dyknow_stream_processing import parse_specification


@pytest.mark.parametrize(
    ('printed', 'canonical'),
    [
        # Figure 2: D is renamed to Fx, where x is the value of C.
        (
            'stream S2 = select A, D as F%C% from S1 where B = 2',
            'stream S2 = select A, D as F%C% from S1 where B = 2',
        ),
        ("select D as F' from S1 where B = 2", "sink select D as F' from S1 where B = 2"),
        (
            "select F' as F'%C'% from S1 where C' ≥ 2",
            "sink select F' as F'%C'% from S1 where C' >= 2",
        ),
        # Figure 3.
        ('stream S3 = merge(S1, S2)', 'stream S3 = merge(S1, S2)'),
        # Figure 4, and a start time.
        (
            'stream S3 = sync(S1, S2) with sample_period = 2',
            'stream S3 = sync(S1, S2) with sample_period = 2 ms',
        ),
        (
            'stream S3 = sync(S1, S2) with start_time = 0, sample_period = 2',
            'stream S3 = sync(S1, S2) with start_time = 0 s, sample_period = 2 ms',
        ),
        # The constraints of the text.
        (
            'S1 with max_delay = 100, sample_period = 200, sample_period_deviation = 50',
            (
                'sink S1 with max_delay = 100 ms, sample_period = 200 ms, '
                'sample_period_deviation = 50 ms'
            ),
        ),
        # Every rule of the grammar.
        (
            'source (A: int, B: float, C: string, D: boolean) T; sink T with max_delay = 1',
            'source (A: int, B: float, C: string, D: boolean) T;\nsink T with max_delay = 1 ms',
        ),
        (
            ('compunit E: float unit(A: int, (B: float, C: string)); stream S = unit(S1, S2) with '
            'end_time = 9000'),
            ('compunit E: float unit(A: int, (B: float, C: string));\n'
            'stream S = unit(S1, S2) with end_time = 9 s'),
        ),
        (
            ('select A.B as %C.D%E%F% from S1 with max_delay = 1 where A = 1 and B = 2 with '
            'end_time = 3'),
            ('sink select A.B as %C.D%E%F% from (S1 with max_delay = 1 ms) where A = 1 and B = 2 '
            'with end_time = 3 ms'),
        ),
    ],
)  # fmt: skip
def test_specifications_of_the_paper(printed: str, canonical: str) -> None:
    specification = parse_specification(printed)
    assert str(specification) == canonical
    assert parse_specification(canonical) == specification


@pytest.mark.parametrize(
    'text', ["source x: int 'T'", "select 'A' from S", "select A from S where B = 'C'"]
)
def test_a_prime_opens_no_text(text: str) -> None:
    with pytest.raises(LanguageError, match='unexpected character "\'"'):
        parse_specification(text)


def test_comments_between_constraints() -> None:
    """A comma may be followed by any comment; this took time exponential in its length."""
    ruler = '#' * 60
    written = parse_specification(
        f'sync(a with max_delay = 1,{ruler}\n{ruler}\n sample_period {ruler}\n = 2, {ruler}\n b)'
    )
    assert str(written) == 'sink sync(a with max_delay = 1 ms, sample_period = 2 ms, b)'
    with pytest.raises(LanguageError):
        parse_specification(f'sync(a with max_delay = 1,{ruler}')
