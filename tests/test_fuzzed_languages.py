"""Mutated texts in every language: no foreign exception, and none takes long.

Each input is an example or a wrong text of the tests, cut, repeated, nested and joined with others.
It is parsed, printed, parsed again and used as nodes use it.
"""

from __future__ import annotations

import os
import re
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dyknow_bringup.simulation.missions import load_mission
from dyknow_bringup.simulation.scenario import load_scenario
from dyknow_common import (
    NO_CONSTRAINTS,
    DyKnowError,
    SymbolKind,
    ValueType,
    absence,
    check_unit,
    format_duration,
    listed_as,
    parse_duration,
    unit_conversion,
)
from dyknow_configuration import read_formulas
from dyknow_coordinator.grounding.completion import with_sorts
from dyknow_coordinator.grounding.feature_sources import referenced_source
from dyknow_coordinator.grounding.scopes import Scopes
from dyknow_reasoning import FormulaGroup, FormulaLimits, parse_formula
from dyknow_reasoning.trace import read_trace
from dyknow_semantics import (
    Annotation,
    Concept,
    Knowledge,
    Ontology,
    check_annotation,
    parse_annotations,
    parse_bridges,
    parse_concept,
)
from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.ontology.bridges import bridge_triple
from dyknow_stream_processing import (
    Dataflow,
    Sample,
    SourceType,
    load_units,
    parse_specification,
    specifications_by_sink,
)
from dyknow_stream_processing.management.naming import NamingConvention, check_name

ROOT = Path(__file__).parent.parent
INPUTS = int(os.environ.get('DYKNOW_RANDOM_CASES', '0')) or 300
"""The number of texts of each language."""

SEED = 3
"""A seed with which the mutations leave some of so few texts correct, in each language."""

LIMIT_S = 10.0
"""The processor time that an input may take on a busy machine; most take a millisecond."""

MAX_LENGTH = 20_000
MAX_MESSAGE = 5_000
SYMBOLS = '()[]{}<>=!+-*/.,;:%#"\'\\|&?@$_ \t\n\r¬∧∨→↔∀∃∈□◇◊U∪≠≤≥∞·′τ\u2028\x00\x1f\ud800é🚁'  # noqa: RUF001
WORDS = re.compile(r"[A-Za-z_]\w*'*|\d+(?:\.\d+)?|\S")


class Mutations:
    """Random texts that resemble a corpus."""

    def __init__(self, corpus: Sequence[str], generator: np.random.Generator) -> None:
        self._corpus = corpus
        self._words = sorted({word for text in corpus for word in WORDS.findall(text)})
        self._generator = generator
        self._kinds = (
            self._cut, self._repeated, self._spliced, self._with_symbol, self._with_word,
            self._nested, self._with_number, self._with_name, self._with_comment, self._chained,
            # Those that leave a text correct, as often as the others.
            *[self._with_other_word] * 6, *[self._with_spaced_symbol] * 4,
        )  # fmt: skip

    def text(self) -> str:
        """Return the next text."""
        text = self._choice(self._corpus)
        for _ in range(int(self._generator.geometric(0.5))):
            text = self._choice(self._kinds)(text)[:MAX_LENGTH]
        return text

    def _choice(self, options: Sequence[Any]) -> Any:
        return options[int(self._generator.integers(len(options)))]

    def _slice(self, text: str) -> slice:
        first, last = sorted(self._generator.integers(0, len(text) + 1, 2))
        return slice(int(first), int(last))

    def _count(self) -> int:
        return int(2 ** self._generator.uniform(1, 9))

    def _inserted(self, text: str, part: str) -> str:
        place = int(self._generator.integers(len(text) + 1))
        return text[:place] + part + text[place:]

    def _cut(self, text: str) -> str:
        part = self._slice(text)
        return text[: part.start] + text[part.stop :]

    def _repeated(self, text: str) -> str:
        part = self._slice(text)
        return text[: part.start] + text[part] * self._count() + text[part.stop :]

    def _spliced(self, text: str) -> str:
        other = self._choice(self._corpus)
        return self._inserted(text, other[self._slice(other)])

    def _with_symbol(self, text: str) -> str:
        return self._inserted(text, self._choice(SYMBOLS))

    def _with_word(self, text: str) -> str:
        return self._inserted(text, f' {self._choice(self._words)} ')

    def _with_other_word(self, text: str) -> str:
        found = list(WORDS.finditer(text))
        if not found:
            return text
        replaced = self._choice(found)
        return text[: replaced.start()] + self._choice(self._words) + text[replaced.end() :]

    def _with_spaced_symbol(self, text: str) -> str:
        found = list(WORDS.finditer(text))
        if not found:
            return text
        place = self._choice(found).start()
        return text[:place] + self._choice([' ', '\n', '\t', '# a\n', '(', ')']) + text[place:]

    def _nested(self, text: str) -> str:
        opening, closing = self._choice(
            [('(', ')'), ('[', ']'), ('not ', ''), ('-', ''), ('always ', ''), ('sync(', ')'),
             ('select a from (', ')'), ('select a from ', ''), ('forall x in UAV: ', '')]
        )  # fmt: skip
        count = self._count()
        part = self._slice(text)
        nested = opening * count + text[part] + closing * count
        return text[: part.start] + nested + text[part.stop :]

    def _with_number(self, text: str) -> str:
        digits = '9' * self._choice([1, 10, 20, 101, 400, 5000])
        number = self._choice([digits, f'0.{digits}', f'1e{digits}', f'-{digits}', f'1e-{digits}'])
        return self._inserted(text, number + self._choice(['', ' ', ' s', ' h', 'ns']))

    def _with_name(self, text: str) -> str:
        return self._inserted(text, self._choice(self._words) * self._count())

    def _with_comment(self, text: str) -> str:
        return self._inserted(text, '#' * self._count() + self._choice(['', '\n', ' ']))

    def _chained(self, text: str) -> str:
        word = f' {self._choice(self._words)} '
        return text + (word + self._choice(self._words)) * self._count()


@dataclass(frozen=True)
class LanguageUse:
    """A language, examples of it, and what its texts are used for."""

    corpus: Sequence[str]
    use: Callable[[str], None]


def blocks(language: str) -> list[str]:
    """Return the examples of a language in the documents."""
    pattern = re.compile(rf'^```{language}\n(.*?)^```$', re.MULTILINE | re.DOTALL)
    documents = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
    return [text for path in documents for text in pattern.findall(path.read_text('utf-8'))]


def files(*patterns: str) -> list[str]:
    """Return the texts of the files of the repository that match."""
    return [path.read_text('utf-8') for each in patterns for path in sorted(ROOT.glob(each))]


def use_formula(text: str) -> None:
    """Evaluate a formula over two states."""
    formula = parse_formula(text)
    assert parse_formula(str(formula)) == formula
    assert with_sorts(Scopes(str(formula)), {}) == str(formula)
    group = FormulaGroup(FormulaLimits(node_limit=1000))
    formula_id = group.add_formula('formula', text)
    for symbol in group.symbols():
        if symbol.is_reference:
            referenced_source(symbol)
    sorts = {symbol.name for symbol in group.symbols() if symbol.kind is SymbolKind.SORT}
    group.begin({sort: ['uav1', 'uav2'] for sort in sorts if not sort.startswith('?')})
    kinds = group.formulas[formula_id].kinds
    samples = {'number': 3, 'string': 'a', 'boolean': True, 'object': 'uav1'}
    values = {
        str(symbol): samples[kinds.get(symbol.name, kinds.get(str(symbol), 'number'))]
        for symbol in group.symbols()
    }
    for valid_time in (0, 10**9):
        group.progress(valid_time, values)
        group.residual(formula_id)
        group.presumably_false(formula_id)


def use_specification(text: str) -> None:
    """Make the stream of a specification."""
    specification = parse_specification(text)
    assert parse_specification(str(specification)) == specification
    with suppress(DyKnowError):
        specifications_by_sink(specification)
    fields = {'x': ValueType.FLOAT, 'a': ValueType.INT, 'ranges[0..]': ValueType.FLOAT}
    types = {'/t': SourceType(fields, receipt_time=False)}
    dataflow = Dataflow(load_units(), types.get)
    dataflow.create('made', specification, NO_CONSTRAINTS, lambda _: None, lambda _: None)
    dataflow.sources()
    for second in range(3):
        dataflow.push('/t', Sample(second * 10**9, second * 10**9 + 1, {'x': 1.0, 'a': 2}))
    dataflow.next_deadline()


class SemanticUse:
    """Uses of texts about the ontology of the UAVs."""

    def __init__(self) -> None:
        with Ontology() as ontology:
            ontology.load(str(ROOT / 'dyknow_bringup/ontology/uav.owl'))
            for name in ('uav1', 'uav2', 'uav3'):
                ontology.create_instance(name, ('UAV',))
            self._knowledge: Knowledge = ontology.knowledge
        self._matcher = Matcher(self._knowledge)

    def use_annotations(self, text: str) -> None:
        """Check annotations against the ontology."""
        annotations: Iterable[Annotation] = parse_annotations(text)
        assert parse_annotations('\n'.join(map(str, annotations))) == annotations
        for each in annotations:
            self._matcher.add('text', each)
            self._matcher.remove('text')
            check_annotation(each, self._knowledge)

    def use_concept(self, text: str) -> None:
        """Match a concept."""
        concept: Concept = parse_concept(text)
        assert parse_concept(str(concept)) == concept
        self._matcher.match(concept)
        self._matcher.nearest(concept)

    def use_bridges(self, text: str) -> None:
        """Apply bridges between ontologies."""
        bridges = parse_bridges(text)
        assert parse_bridges('\n'.join(map(str, bridges))) == bridges
        for each in bridges:
            bridge_triple(each, self._knowledge)


def use_duration(text: str) -> None:
    """Read a duration as all readers of durations do."""
    try:
        duration = parse_duration(text)
    except ValueError as error:
        raise DyKnowError(str(error)) from None
    assert parse_duration(format_duration(duration)) == duration


def use_field_path(text: str) -> None:
    """Look a path up in the fields of a message."""
    fields = ['pose.position.z', 'covariance[0..35]', 'ranges[0..]', 'points[0..].x']
    listed_as(fields, text)
    listed_as([*fields, text], 'ranges[7]')
    absence('the message', fields, text)


def use_unit(text: str) -> None:
    """Convert a unit."""
    check_unit(text)
    convert = unit_conversion(text, 'm')
    if convert:
        convert(1.0)


def use_name(text: str) -> None:
    """Name a stream and its topic."""
    NamingConvention('streams/<name>').name(text)
    with suppress(DyKnowError):
        check_name(text)
    NamingConvention(text).name('/dyknow/streams/speed')


def use_trace(text: str) -> None:
    """Read recorded states."""
    for _ in read_trace(text.splitlines()):
        pass


def yaml_use(read: Callable[[Path], object]) -> Callable[[str], None]:
    """Return the use of a reader of YAML files."""
    folder = Path(tempfile.mkdtemp())

    def use(text: str) -> None:
        path = folder / 'document.yaml'
        path.write_text(text, 'utf-8', errors='replace')
        read(path)

    return use


def languages() -> Mapping[str, LanguageUse]:
    """Return all languages."""
    semantic = SemanticUse()
    yaml = 'dyknow_bringup'
    return {
        'formula': LanguageUse(
            [line for text in blocks('formula') for line in text.splitlines()] * 9
            + files('dyknow_reasoning/test/bad_formulas/*.formula'),
            use_formula,
        ),
        'stream': LanguageUse(
            [
                'select x, a as "b[%a%]" from "/t" where x > 0.5 and a != 3 with max_delay = 1 s',
                'source (x: float) "/t"; stream b = select x from "/t"; sink merge(b, "/t")',
                'compunit x: float mean(x: float); sink mean("/t", window = 5 s)',
                (
                    'sync("/t", select a as c from "/t" with sample_period = 1 s, end_time = 9 s) '
                    'with sample_period = 1 s, approximation = linear'
                ),
            ]
            * 5
            + blocks('streams')
            + files('dyknow_stream_processing/test/bad_specifications/*.stream'),
            use_specification,
        ),
        'annotation': LanguageUse(
            [each for text in blocks('ssl') for each in text.split(';')] * 5
            + [
                (
                    'stream a contains Power[uav1] = power [W], XYDist[u, v] = d [km] '
                    'for every u in UAV, v ∈ Vehicle where u = id, v = other with max_delay = 1 s'
                )
            ]
            * 20
            + blocks('ssl')
            + files('dyknow_semantics/test/bad_annotations/*.ssl'),
            semantic.use_annotations,
        ),
        'concept': LanguageUse(
            ['Power', 'Power[uav1]', 'XYDist[x, uav1] for every x in UAV', 'uav:Power'] * 9
            + files('dyknow_semantics/test/bad_concepts/*.concept'),
            semantic.use_concept,
        ),
        'bridges': LanguageUse(
            ['uav:Power equivalent Power; UAV into uav:Vehicle; # a\n uav1 same "uav:uav1"'] * 9
            + blocks('bridges')
            + files('dyknow_semantics/test/bad_bridges/*.bridges'),
            semantic.use_bridges,
        ),
        'duration': LanguageUse(['200 ms', '0.5s', '1000', '-3 h', '1 min', '7 ns'], use_duration),
        'field_path': LanguageUse(
            ['pose.position.z', 'covariance[35]', 'ranges[0..7]', 'points[2].x', 'ranges'],
            use_field_path,
        ),
        'unit': LanguageUse(['m', 'ft', 'm/s^2', 'degC', '%', 'kg*m**2', '1/s', 'dBm'], use_unit),
        'name': LanguageUse(['speed', 'dyknow/streams/<name>', '/<name>/data'], use_name),
        'trace': LanguageUse(
            ['time_s,Power[uav1],p\n0.1,3,true\n0.2,4.5e3,false', 'time_ns,"D[a, b]"\n1,"on"'],
            use_trace,
        ),
        'scenario': LanguageUse(
            files(f'{yaml}/scenarios/*.yaml', f'{yaml}/test/bad_scenarios/*.yaml'),
            yaml_use(load_scenario),
        ),
        'plan': LanguageUse(files(f'{yaml}/plans/*.yaml'), yaml_use(load_mission)),
        'formulas': LanguageUse(files(f'{yaml}/formulas/*.yaml'), yaml_use(read_formulas)),
    }


LANGUAGES = languages()


@pytest.mark.parametrize('name', LANGUAGES)
def test_mutated_texts(name: str) -> None:
    language = LANGUAGES[name]
    texts = Mutations(language.corpus, np.random.default_rng(SEED))
    accepted = 0
    for _ in range(INPUTS):
        text = texts.text()
        with limited_time(text):
            try:
                language.use(text)
                message = ''
                accepted += 1
            except DyKnowError as error:
                message = error.message
            except Exception as error:
                error.add_note(f'for the text {text!a:.500}')
                raise
        assert len(message.encode()) <= MAX_MESSAGE, f'message for {text!a:.500}'
    assert accepted


@contextmanager
def limited_time(text: str) -> Iterator[None]:
    """Interrupt what takes more processor time than the limit."""

    def interrupt(*_: object) -> None:
        raise AssertionError(f'takes more than {LIMIT_S} s: {text!a:.500}')

    before = signal.signal(signal.SIGVTALRM, interrupt)
    signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
