"""Large and deep texts in all languages: accepted or refused, each in a few seconds.

Each text is so long that a parser that needs quadratic time would need more.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from time import process_time
from unittest import mock

import pytest

from dyknow_common import (
    MAX_DEPTH,
    NO_CONSTRAINTS,
    DyKnowError,
    LanguageError,
    ValueType,
    absence,
    check_unit,
    listed_as,
    parse_duration,
)
from dyknow_common.parsing import language
from dyknow_reasoning import FormulaGroup, ReasoningError, parse_formula
from dyknow_reasoning.language import type_checking
from dyknow_semantics import parse_annotations, parse_bridges, parse_concept
from dyknow_stream_processing import (
    Dataflow,
    Sample,
    SourceType,
    load_units,
    parse_specification,
    specifications_by_sink,
)

Parse = Callable[[str], object]

MANY = 10_000
"""A number of characters that are words of their own."""

LONG = 50_000
"""A number of characters within one word."""

LIMIT_S = 10
"""Seconds of the processor: ten times what a test needs, and 100 ns for each pair of MANY words."""

EXAMPLES: dict[Parse, str] = {
    parse_formula: 'forall u in UAV : always [ 0 , 5s ] Power [ u ] + 1 < "a" . b until p',
    parse_specification: (
        'source ( x : float ) "/t" ; compunit x : float mean ( x : float ) ; '
        'stream a = select x as y , z from sync ( b with max_delay = 1s , '
        'sample_period = 2s , mean ( "/t" , window = 5s ) ) where x > 0.5 with max_delay = 1s'
    ),
    parse_annotations: (
        'stream a contains Power [ u , b ] = x [m] , Mode = y for every u in UAV where u = z '
        'with max_delay = 1s , sample_period = 2s ;'
    ),
    parse_concept: 'Power [ u ] for every u in UAV',
    parse_bridges: 'a:b equivalent "c" ; d into e ;',
}
COMMENTED = (parse_specification, parse_annotations, parse_bridges, parse_concept)
RULERS = ('#' * LONG, '#' * 60 + '\n', '#\n' * MANY, '\n' * LONG, ' ' * LONG)


@pytest.fixture(autouse=True)
def _not_in_quadratic_time() -> Iterator[None]:
    begin = process_time()
    yield
    assert process_time() - begin < LIMIT_S


def tried(parse: Parse, text: str) -> str:
    """Parse a text; return the error if it is refused, whose message must be short."""
    try:
        parse(text)
    except DyKnowError as error:
        message = error.message
        message.encode()
        assert len(message) < 2000
        return message
    return ''


def formula_group(text: str) -> None:
    """Do with a formula all that a node does."""
    group = FormulaGroup()
    formula_id = group.add_formula('formula', text)
    formula = str(group.formulas[formula_id])
    assert parse_formula(formula) == group.formulas[formula_id].formula
    group.symbols()
    group.begin({'UAV': ['uav1', 'uav2']})
    for time, value in enumerate((True, False, True)):
        group.progress(time * 10**9, dict.fromkeys(map(str, group.symbols()), value))
        group.residual(formula_id)
        group.presumably_false(formula_id)
        group.gap()


def dataflow(text: str) -> None:
    """Do with a stream specification all that a node does."""
    specification = parse_specification(text)
    assert parse_specification(str(specification)) == specification
    source = SourceType({'x': ValueType.FLOAT}, receipt_time=False)
    flow = Dataflow(load_units(), lambda _: source)
    samples: list[Sample] = []
    flow.create('made', specification, NO_CONSTRAINTS, samples.append, lambda _: None)
    flow.sources()
    for second in range(4):
        flow.push('/t', Sample(second * 10**9, second * 10**9 + 1, {'x': 1.0}))
    flow.advance(10**12)
    assert samples
    flow.destroy('made')


def below(frames: int, function: Callable[[], None]) -> None:
    """Call a function with more of the stack used than by a node."""
    if frames:
        below(frames - 1, function)
    else:
        function()


@pytest.mark.parametrize('parse', EXAMPLES)
def test_the_examples_are_accepted(parse: Parse) -> None:
    text = EXAMPLES[parse]
    if parse is not parse_formula:  # It compares a number with a text.
        assert not tried(parse, text)
    assert tried(parse, text + ' )')


@pytest.mark.parametrize('parse', COMMENTED)
@pytest.mark.parametrize('ruler', RULERS, ids=range(len(RULERS)))
def test_comments_at_every_place(parse: Parse, ruler: str) -> None:
    text = EXAMPLES[parse]
    places = [found.start() for found in re.finditer(' ', text)]
    if len(ruler) > 10_000:
        places = places[:: len(places) // 2]
    for place in places:
        assert not tried(parse, f'{text[:place]} {ruler}\n{text[place:]}')
    for place in places[::10]:
        # The rest of the text is a comment.
        tried(parse, f'{text[:place]} {ruler}{text[place:]}')


@pytest.mark.parametrize('parse', EXAMPLES)
@pytest.mark.parametrize(
    'ruler', ['(', '[', '"', 'a', "'", '1', '.', ' ', '\\', '-', '#', '%', ',']
)
def test_rulers(parse: Parse, ruler: str) -> None:
    text = EXAMPLES[parse]
    places = [found.start() for found in re.finditer(' ', text)]
    place = places[len(places) // 3]
    for ruled in (ruler * MANY, f'{ruler} ' * (MANY // 2)):
        tried(parse, f'{text[:place]} {ruled} {text[place:]}')


@pytest.mark.parametrize(
    ('parse', 'text'),
    [
        (parse_formula, f'p[{"a, " * (MANY // 2)}a]'),
        (parse_formula, ' and '.join(['(p or q)'] * (MANY // 6))),
        (parse_formula, ' <-> '.join(['p'] * (MANY // 2))),
        (parse_formula, ' + '.join(['p'] * (MANY // 2)) + ' < 3'),
        (parse_formula, ' + '.join(['p'] * (MANY // 2))),
        (parse_formula, 'not ' * MANY + 'p'),
        (parse_formula, '-' * MANY + '1 < p'),
        (parse_formula, '(' * (MANY // 2) + 'p' + ')' * (MANY // 2)),
        (parse_formula, '(' * MANY),
        (parse_formula, 'p)' * (MANY // 2)),
        (parse_formula, f'p."{"a" * LONG}"'),
        (parse_formula, f'a.{"b." * (LONG // 2)}c'),
        (parse_specification, f'merge({"a, " * (MANY // 2)}a)'),
        (parse_specification, 'sync(' * MANY),
        (parse_specification, '(' * (MANY // 2) + 'a' + ')' * (MANY // 2)),
        (parse_specification, 'select a from ' * (MANY // 3) + 'b'),
        (parse_specification, f'select {"a as b, " * (MANY // 4)}a from b'),
        (parse_specification, f'select {"a.b[0]." * (LONG // 8)}a from b'),
        (parse_specification, f'select a as {"%a%" * (LONG // 4)} from b'),
        (parse_specification, f'select a as {"%a" * (LONG // 4)}: from b'),
        (parse_specification, f'a with {"max_delay = 1, " * (MANY // 4)}max_delay = 1'),
        (parse_specification, f'source ({"x: int, " * (MANY // 4)}x: int) "/t"; sink "/t"'),
        (parse_annotations, f'stream a contains p[{"a, " * (MANY // 2)}a] = b'),
        (parse_annotations, 'stream a contains p = b;' * (MANY // 6)),
        (parse_concept, f'p[{"a, " * (MANY // 2)}a]'),
        (parse_bridges, 'a into b;' * (MANY // 4)),
    ],
)
def test_long_texts(parse: Parse, text: str) -> None:
    assert 'more than' not in tried(parse, text)


@pytest.mark.parametrize('parse', EXAMPLES)
def test_too_many_words(parse: Parse, monkeypatch: pytest.MonkeyPatch) -> None:
    """Words are counted before they are parsed, in one way for all languages."""
    monkeypatch.setattr(language, 'MAX_WORDS', MANY)
    word = ';' if parse is parse_bridges else '('
    assert 'more than' not in tried(parse, word * MANY)
    assert 'has more than 10000 words and' in tried(parse, word * (MANY + 1))


@pytest.mark.parametrize('first', ['a0 = 3', 'p[a0]'])
def test_names_of_a_long_formula(first: str) -> None:
    """Names that are compared with each other are resolved in linear time."""
    count = 1000
    parts = [f'a{number} = a{number + 1}' for number in reversed(range(count))]
    checker = type_checking._TypeChecker
    infer = mock.patch.object(
        checker,
        '_infer_equality',
        autospec=True,
        side_effect=checker._infer_equality,
    )
    with infer as inferred:
        FormulaGroup().add_formula('formula', ' and '.join([first, *parts]))
    assert count <= inferred.call_count <= 4 * count


@pytest.mark.parametrize(
    'make',
    [
        *(lambda n, op=op: f' {op} '.join(['p', 'q'] * (n // 2))[: -2 * (n % 2) or None]
          for op in ('->', 'until', 'until[0 s, 1 s]')),
        lambda n: 'not ' * (n - 1) + 'p',
        lambda n: 'always[0 s, 1 s] eventually[0 s, 1 s] ' * ((n - 2) // 2) + 'not p',
        lambda n: 'always exists u in UAV: ' + 'not ' * (n - 4) + 'P[u]',
        lambda n: ' - '.join(['p'] * (n - 1)) + ' < 3',
        lambda n: '-' * (n - 3) + 'p < 3',
    ],
)  # fmt: skip
def test_the_deepest_formula(make: Callable[[int], str]) -> None:
    below(150, lambda: formula_group(make(MAX_DEPTH)))
    with pytest.raises(LanguageError, match='the formula nests deeper than 100 levels') as error:
        parse_formula(make(MAX_DEPTH + 2))
    assert error.value.position.line == 1


@pytest.mark.parametrize(
    'text',
    [
        'let d = {} in eventually p > d',
        'let d = {} in p > d',
        'let p ~ normal(p, {}) in P(' + 'not ' * 40 + 'p > 3) > 0.9',
        'not ' * (MAX_DEPTH - 4) + '(let d = {} in eventually p > d)',
    ],
)
@pytest.mark.parametrize('term', ['q' + ' - q' * 1000, '-' * 1000 + 'q', 'q' + ' - q' * 90])
def test_terms_of_let_count_before_they_are_used(text: str, term: str) -> None:
    with pytest.raises(LanguageError, match=r'deeper than 100 levels|has more than 100 parts'):
        parse_formula(text.format(term))
    assert parse_formula(text.format('q + 1').replace('not ', ''))


@pytest.mark.parametrize('every_state', [False, True])
@pytest.mark.parametrize(
    'make',
    [
        lambda names: ' and '.join(f'{each} > 1' for each in names),
        lambda names: ' or '.join(f'{each} > 2' for each in names),
        lambda names: f'historically ({" + ".join(names)} > {len(names)})',
    ],
)
def test_flat_parts_do_not_nest(make: Callable[[list[str]], str], *, every_state: bool) -> None:
    names = [f'x{number}' for number in range(500)]
    text = f'always ({make(names)})'
    formula = parse_formula(text)
    assert parse_formula(str(formula)) == formula
    group = FormulaGroup()
    formula_id = group.add_formula('formula', text, every_state=every_state, margin=True)

    def progress() -> None:
        group.begin({})
        assert group.progress(0, dict.fromkeys(names, 3.0)) == []
        assert group.residual(formula_id)
        if every_state:
            group.progress(1, dict.fromkeys(names, 1.0))
            assert group.standing.summary(formula_id).latest_episodes
        else:
            (result,) = group.progress(1, dict.fromkeys(names, 1.0))
            assert 'x0' in result.explanation
            assert result.margin is not None

    below(150, progress)


def test_flat_conditions_do_not_nest() -> None:
    path = ' or '.join(f'a = {number} and b < 3' for number in range(1000))
    expected = f'any({path})'
    group = FormulaGroup()
    group.add_formula('formula', expected.replace('a =', 's.a =').replace('b <', 's.b <'))
    (symbol,) = group.symbols()
    assert symbol.reference == ('s', expected)


def test_a_formula_that_doubles() -> None:
    formula_group(' <-> '.join(['p', 'q'] * 6))
    group = FormulaGroup()
    group.add_formula('formula', ' <-> '.join(['p', 'q'] * 49))
    with pytest.raises(ReasoningError, match=r"nodes, more than 100000 .*; each '<->' doubles"):
        group.begin({})


def nested(opening: str, closing: str, depth: int) -> str:
    return opening * (depth - 1) + '"/t"' + closing * (depth - 1)


@pytest.mark.parametrize(
    ('opening', 'closing'),
    [
        ('select x from ', ''),
        ('select x from (', ') where x > 0'),
        ('select x from (', ' with max_delay = 1 s, end_time = 50000 s)'),
        ('merge(', ')'),
        ('sync(', ' with sample_period = 1 s, start_time = 0 s)'),
    ],
)
def test_the_deepest_stream(opening: str, closing: str) -> None:
    below(150, lambda: dataflow(nested(opening, closing, MAX_DEPTH)))
    with pytest.raises(LanguageError, match='nests deeper than 100 levels'):
        parse_specification(nested(opening, closing, MAX_DEPTH + 1))


@pytest.mark.parametrize('reverse', [False, True])
def test_the_longest_chain_of_streams(reverse: bool) -> None:  # noqa: FBT001
    def chain(length: int) -> str:
        texts = [f'stream a{each} = select x from a{each - 1}' for each in range(1, length)]
        return ';'.join(['stream a0 = "/t"', *(reversed(texts) if reverse else texts)])

    below(150, lambda: dataflow(chain(MAX_DEPTH)))
    for length in (MAX_DEPTH + 1, 2000):  # More than Python may recurse.
        with pytest.raises(LanguageError, match='more than 100 streams, one'):
            dataflow(chain(length))


def test_a_stream_that_doubles() -> None:
    doubled = ';'.join(f'stream a{each} = merge(a{each - 1}, a{each - 1})' for each in range(1, 90))
    with pytest.raises(LanguageError, match='repeat each sample of a stream more than 100 times'):
        dataflow(f'stream a0 = "/t"; {doubled}')


def test_many_sinks() -> None:
    count = 3000
    text = ';'.join(f'stream a{each} = "/t"; sink a{each}' for each in range(count))
    assert len(specifications_by_sink(parse_specification(text))) == count


@pytest.mark.parametrize('quantifier', ['forall', 'exists'])
def test_choices_of_too_many_objects(quantifier: str) -> None:
    group = FormulaGroup()
    bound = ''.join(f'{quantifier} u{each} in UAV: ' for each in range(40))
    group.add_formula('formula', f'{bound} P[u0]')
    with pytest.raises(ReasoningError, match=r'parts for each choice|instances for these'):
        group.begin({'UAV': ['uav1', 'uav2']})


def test_other_texts() -> None:
    assert parse_duration('5' + ' ' * LONG) == parse_duration('5 ms')
    for text in ('9' * LONG, '9' * LONG + ' s', ' ' * LONG, '-' * LONG):
        with pytest.raises(ValueError, match=r'^.{,300}$'):
            parse_duration(text)
    for text in ('a[' + '9' * LONG, 'a[' + '9' * LONG + ']', 'a[0]' * (LONG // 4), '.' * LONG):
        assert listed_as(['a[0..35]', 'b[0..]'], text) is None
        assert listed_as(['a[0..]'], text) is None
        absence('it', ['a[0..35]'], text)
    for text in ('m' * LONG, '(' * 90 + 'm' + ')' * 9, '1' * 99, 'm^99' * 20, 'km ' * 33):
        tried(check_unit, text)
