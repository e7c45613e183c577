"""Grounding of formulas: the steps of the coordinator, without its nodes."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from dyknow_common import (
    NO_CONSTRAINTS,
    LanguageError,
    StreamConstraints,
    Symbol,
    TypeConstants,
    constant_names,
    message_constant,
)
from dyknow_coordinator import (
    Candidates,
    CandidateSearch,
    CoordinationError,
    FeatureSource,
    FormulaInputs,
    Grounding,
    check_compared_objects,
    check_symbols,
    completed,
    feature_units,
    ground_features,
    parse_sources,
    sort_names,
    unknown_features,
)
from dyknow_reasoning import (
    NO_CONSTANTS,
    Constants,
    FormulaGroup,
    asks_for_probability,
    is_uncertain,
    literal_of,
    parse_formula,
    stated_units,
)
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.evaluation.vocabulary import Vocabulary

Result = TypeVar('Result')


@dataclass(frozen=True, slots=True)
class GroundedFormula:
    """A formula and what its states are made of.

    Args:
        formula: the canonical text, with all sorts.
        trigger: the canonical text of the formula that begins its episodes; empty without one.
        inputs: the inputs of the state stream, for both.
        units: the unit of each of its features; empty for a feature without a unit.
        margin: True to compute its margin.
        probability: the canonical text that asks for its probability; empty if nobody asks for it,
            or nothing in the formula is uncertain.
    """

    formula: str
    trigger: str
    inputs: FormulaInputs
    units: Mapping[str, str] = field(default_factory=dict)
    margin: bool = False
    probability: str = ''


class FormulaGrounder:
    """Finds the objects and streams of formulas.

    Args:
        vocabulary: the vocabulary of the formulas.
        streams: the streams of the recording.
        states: the specification of the states of the only formula; empty: find its sources.
        constraints: the constraints of the states.
        types: gives the constants of recorded message types.
    """

    def __init__(
        self,
        vocabulary: Vocabulary,
        streams: RecordedStreams,
        *,
        states: str = '',
        constraints: StreamConstraints = NO_CONSTRAINTS,
        types: Callable[[], TypeConstants] = dict,
    ) -> None:
        self._states, self._types = states, types
        self._constraints = constraints
        self._vocabulary = vocabulary
        self._streams = streams
        self._search = CandidateSearch(self._matching_sources, streams.fields)

    def ground(
        self,
        formula: str,
        trigger: str = '',
        constants: Constants = NO_CONSTANTS,
        *,
        margin: bool = False,
        probability: bool = False,
    ) -> GroundedFormula:
        """Return the inputs of a formula, and of the trigger of its episodes.

        Args:
            formula: its text.
            trigger: the text of the formula that begins its episodes; empty without one.
            constants: the values of names that the texts do not define.
            margin: True if the margin of the formula is to be computed.
            probability: True if its probability is to be computed.

        Raises:
            DyKnowError: if a text is no formula, or has a sort or a feature that is not found.
        """
        group = FormulaGroup()
        texts = [self._completed(text, constants) for text in filter(None, (formula, trigger))]
        asked = self._probability(formula, constants) if probability else ''
        for text in filter(None, (*texts, asked)):
            _add(group, text, margin=margin and text is texts[0])
        symbols = tuple(group.symbols())
        domains = self._domains(symbols, texts)
        candidates = self._candidates(symbols)
        group.begin(domains)
        features = ground_features(group.symbols())
        candidates = self._with_fields(candidates, features)
        candidates.choose(features)
        unknown = _finished(unknown_features(symbols, self._query))
        inputs = FormulaInputs(
            symbols, Grounding.AUTO, features, candidates, domains, self._constraints, unknown
        )
        units = self._units(symbols, formula, constants)
        begin = texts[1] if trigger else ''
        return GroundedFormula(texts[0], begin, inputs, units, margin, asked)

    def _units(
        self, symbols: Sequence[Symbol], formula: str, constants: Constants
    ) -> dict[str, str]:
        """Return the units of features; a text that was completed elsewhere may state some."""
        known = _finished(feature_units(symbols, self._query))
        stated = stated_units(formula, constants).items()
        return {**known, **{name: unit for name, unit in stated if not known.get(name)}}

    def _probability(self, formula: str, constants: Constants) -> str:
        """Return the canonical text that asks for the probability of a formula; may be empty."""
        if asks_for_probability(parse_formula(formula, constants)):
            return ''
        asked = self._completed(f'P({formula}) >= 0', constants)
        return asked if is_uncertain(parse_formula(asked)) else ''

    def _with_fields(self, candidates: Candidates, features: Sequence[str]) -> Candidates:
        """Add fields: a recording without annotations, such as a table, has features for them."""
        found = {each.feature for each in candidates.found}
        is_known = self._vocabulary.knowledge is not None
        fields = (
            self._streams.source_of_field(each, is_known=is_known)
            for each in features
            if each not in found
        )
        more = tuple(each for each in fields if each is not None)
        return replace(candidates, found=(*candidates.found, *more))

    def _domains(
        self, symbols: Sequence[Symbol], texts: Sequence[str]
    ) -> dict[str, tuple[str, ...]]:
        domains = {sort: self._vocabulary.instances(sort) for sort in sort_names(symbols)}
        for text in texts:
            _finished(check_compared_objects(text, domains, self._query))
        return domains

    def _candidates(self, symbols: Sequence[Symbol]) -> Candidates:
        if self._states:
            return Candidates(parse_sources([self._states]))
        return _finished(self._search.find(symbols, Grounding.AUTO))

    def _completed(self, text: str, constants: Constants) -> str:
        """Return the canonical text of a formula, with all sorts, and numbers without units."""
        group = FormulaGroup()
        if names := constant_names(text):
            constants = (*constants, *recorded_constants(names, self._types()))
        formula_id = group.add_formula(text, text, constants)
        symbols: Sequence[Symbol] = group.symbols()
        check_symbols(symbols, Grounding.AUTO)
        canonical = str(group.formulas[formula_id])
        return _finished(completed(canonical, symbols, self._instances, self._query))

    async def _instances(self, sorts: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
        return {sort: self._vocabulary.instances(sort) for sort in sorts}

    async def _matching_sources(self, concept: str) -> tuple[FeatureSource, ...]:
        return parse_sources(self._vocabulary.matching_streams(concept))

    async def _query(self, sparql: str) -> Sequence[tuple[str, ...]]:
        return self._vocabulary.query(sparql)


def recorded_constants(names: Iterable[str], types: TypeConstants) -> Constants:
    """Return the values of the names that are constants of message types.

    Raises:
        DyKnowError: for a constant that its type does not have, or with several values.
    """
    values = {name: message_constant(name, types) for name in names}
    return tuple((name, literal_of(each)) for name, each in values.items() if each is not None)


def _add(group: FormulaGroup, text: str, *, margin: bool) -> None:
    try:
        group.add_formula(text, text, margin=margin)
    except LanguageError as error:  # At a position in a text that nobody wrote.
        raise CoordinationError(error.reason, error.code) from None


def _finished(coroutine: Coroutine[Any, Any, Result]) -> Result:
    """Return the result of a coroutine that waits for nothing."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        result: Result = end.value
        return result
    raise AssertionError('a coroutine of offline grounding waits')
