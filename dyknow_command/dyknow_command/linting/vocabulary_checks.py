"""Checks of all files together: do their names mean something, and is everything used."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import replace
from difflib import SequenceMatcher

from dyknow_command.linting.findings import FilePlace, Finding, FindingLevel, error_at, warning_at
from dyknow_command.linting.inputs import LintInputs, PlacedFormula
from dyknow_command.observing import absolute_topic
from dyknow_common import (
    NO_CONSTRAINTS,
    DyKnowError,
    ExitCode,
    InlineText,
    LanguageError,
    Symbol,
    SymbolKind,
    absence,
    listed_as,
    position_at,
    read_file,
    read_text,
)
from dyknow_configuration import POSITION_FEATURES, ConfigurationError, TextSource
from dyknow_reasoning import ForecastFeature, FormulaGroup, mixed_units, parse_formula
from dyknow_recordings import (
    FormulaGrounder,
    GroundedFormula,
    RecordedStreams,
    TopicContent,
    Vocabulary,
    load_vocabulary,
)
from dyknow_semantics import (
    Annotation,
    Knowledge,
    Ontology,
    bridge_triple,
    check_annotation,
    check_fields,
    parse_annotations,
    parse_bridges,
    void_statements,
)
from dyknow_stream_processing import (
    WHOLE,
    BuiltInSource,
    Dataflow,
    SourceType,
    StreamDeclaration,
    StreamReference,
    Term,
    built_in_fields,
    load_units,
    made,
    parse_specification,
    read_streams,
)

_NAMED = re.compile(
    r"""'(?P<number>[\d.e+-]+)\ "(?P<unit>[^"]+)"|'(?P<name>[A-Za-z_][\w:]*)"""
    r"""|\b(?P<feature>[A-Za-z_]\w*)\["""
)

_MISSPELT = re.compile(r"'(\w+)'; did you mean '(\w+)'\?")
_DEFINED = re.compile(r'\b(?:stream|sink)\s+((?:\w|\{[^{}\n]*\})+)')
_UNCERTAINTIES = 'SELECT ?text { ?feature <http://www.dyknow.org/ontology#uncertainty> ?text }'

_SIMILARITY = 0.8
"""From this similarity on (0 to 1), a peer's name is taken for an own name."""

Contents = Mapping[str, TopicContent]


class VocabularyChecks:
    """Checks of files that are correct by themselves.

    Args:
        inputs: the files.
        contents: what the messages of topics hold, as far as it is known.
    """

    def __init__(self, inputs: LintInputs, contents: Contents) -> None:
        self._inputs = inputs
        self._contents = contents
        self._unfit: set[str] = set()

    def findings(self) -> Iterator[Finding]:
        """Yield what is wrong or unused."""
        inputs = self._inputs
        found = [
            *_ontology_findings(inputs),
            *stream_findings(inputs, self._contents),
        ]
        yield from found
        if any(each.level is FindingLevel.ERROR for each in found):
            return
        try:
            vocabulary = load_vocabulary(inputs.files, self._contents)
        except DyKnowError as error:
            yield error_at(FilePlace('files'), error)
            return
        with closing(vocabulary):
            if vocabulary.knowledge is not None:
                yield from self._annotation_findings(vocabulary.knowledge.stated)
                yield from self._bridge_findings(vocabulary.knowledge.stated)
                yield from self._name_findings(vocabulary.knowledge)
            if inputs.has_robot or inputs.files.ontologies:
                yield from self._formula_findings(vocabulary)
            else:
                yield from self._reference_findings()
                for formula in inputs.formulas:
                    named = {topic: frozenset({field}) for topic, field in references_of(formula)}
                    yield from self._stamp_findings(formula, named)
            if vocabulary.knowledge is not None:
                yield from self._unused(vocabulary.knowledge, vocabulary)

    def _annotation_findings(self, knowledge: Knowledge) -> Iterator[Finding]:
        if not self._inputs.files.ontologies:
            return  # Their words are from an ontology that was not given.
        for source, annotation in annotations_of(self._inputs):
            try:
                check_annotation(annotation, knowledge)
                content = self._contents.get(annotation.stream)
                if annotation.is_topic and content is not None and content.fields is not None:
                    check_fields(annotation, knowledge, content.message_type, content.fields)
            except LanguageError as error:
                self._unfit |= {each.feature.name for each in annotation.contents}
                place = self._inputs.place_of(source)
                if isinstance(source, InlineText):
                    yield error_at(place, error.reason)
                else:
                    yield error_at(place, error)

    def _bridge_findings(self, knowledge: Knowledge) -> Iterator[Finding]:
        for source in self._inputs.files.bridges if self._inputs.files.ontologies else ():
            for bridge in read_file(source, 'bridges', parse_bridges, ConfigurationError):
                try:
                    bridge_triple(bridge, knowledge)
                except LanguageError as error:
                    yield error_at(self._inputs.place_of(source), error)

    def _name_findings(self, knowledge: Knowledge) -> Iterator[Finding]:
        """Yield the names that a federation and domains have for nothing on this host."""
        inputs = self._inputs
        known: dict[str, Callable[[str], object]] = {
            'same': knowledge.instance,
            'share': knowledge.feature,
        }
        if not inputs.has_peers:
            known['domains'] = knowledge.subconcepts
        for (section, name), place in inputs.places.items():
            try:
                if section in known:
                    known[section](name)
            except DyKnowError as error:
                if not inputs.is_consequence(error.message):
                    yield error_at(place, error)

    def _formula_findings(self, vocabulary: Vocabulary) -> Iterator[Finding]:
        streams = RecordedStreams(self._contents, self._inputs.files.streams)
        grounder = FormulaGrounder(vocabulary, streams)
        for formula in self._inputs.formulas:
            requested = formula.requested
            try:
                grounded = grounder.ground(requested.text, constants=requested.constants)
                found = streams.prepare(grounded.inputs.candidates.found)
                yield from self._stamp_findings(formula, found)
                yield from _unit_findings(formula, grounded)
            except DyKnowError as error:
                reason = _reason(error)
                is_unfit = any(f'no stream carries {each}' in reason for each in self._unfit)
                place = formula.place(_mentioned(reason, requested.text))
                if is_unfit or self._inputs.is_consequence(reason):
                    continue
                if not (self._inputs.has_peers and error.code is ExitCode.NOT_FOUND):
                    yield error_at(place, reason)
                elif (names := _MISSPELT.search(reason)) and (
                    SequenceMatcher(None, names[1], names[2]).ratio() >= _SIMILARITY
                ):
                    text = f"{reason} If a peer shares '{names[1]}', declare it here, too"
                    yield warning_at(place, text)
        yield from self._reference_findings()

    def _stamp_findings(
        self, formula: PlacedFormula, topics: Mapping[str, frozenset[str]]
    ) -> Iterator[Finding]:
        """Yield that a formula compares topics with stamps with others; given the fields read."""
        # The built-in sources of whole messages find the stamps in them.
        read = [
            name for name in sorted(topics) if name in self._contents and WHOLE not in topics[name]
        ]
        stamped = [name for name in read if self._contents[name].has_stamp]
        unstamped = [name for name in read if not self._contents[name].has_stamp]
        if stamped and unstamped:
            text = (
                f'it compares {unstamped[0]}, which has no stamps and is valid from its sending, '
                f'with {stamped[0]}, which is valid from its stamps: the times differ by what the '
                'sensors and their drivers take; publish a type with a stamp if that matters'
            )
            yield warning_at(formula.place(0), text)

    def _reference_findings(self) -> Iterator[Finding]:
        """Yield the fields that formulas name, and that messages or built-in sources lack."""
        for formula in self._inputs.formulas:
            for source, field in sources_of(formula):
                if (lack := self._lack(source, field)) is not None:
                    yield error_at(formula.place_of(field), lack)

    def _lack(self, source: Term, field: str) -> str | None:
        """Return the message that a source lacks a field; None if it may have it."""
        if isinstance(source, BuiltInSource):
            fields = built_in_fields(source)
            return None if field in fields else absence(str(source.kind), fields, field)
        if not (isinstance(source, StreamReference) and source.is_topic):
            return None
        topic = absolute_topic(source.name)
        content = self._contents.get(topic)
        if content is None or content.fields is None or listed_as(content.fields, field):
            return None
        return f'{topic}: {absence(content.message_type, content.fields, field)}'

    def _unused(self, knowledge: Knowledge, vocabulary: Vocabulary) -> Iterator[Finding]:
        """Yield features and sorts that mean nothing."""
        inputs = self._inputs
        used = self._used_concepts(knowledge) | inputs.shared
        arguments = {sort for each in knowledge.features for sort in each.argument_sorts}
        for sort in sorted(arguments if not inputs.has_peers else ()):
            if not vocabulary.instances(sort) and not inputs.is_consequence(f"'{sort}'"):
                text = f"the sort '{sort}' has no objects: formulas over it say nothing; add some"
                yield warning_at(self._place('objects', sort), text)
        uncertainties = [text.partition(',')[2] for (text,) in vocabulary.query(_UNCERTAINTIES)]
        for feature in knowledge.features if inputs.formulas else ():
            near = {*knowledge.superconcepts(feature.name), *knowledge.subconcepts(feature.name)}
            is_used = near & used or _is_in(feature.name, inputs.refused)
            # The bounds of a forecast are declared together, and so are the features of positions,
            # and the features that measure uncertainties.
            is_given = ForecastFeature.of(feature.name) or feature.name in POSITION_FEATURES
            is_given = is_given or _is_in(feature.name, uncertainties)
            if not (is_used or is_given) and not inputs.is_consequence(f"'{feature.name}'"):
                text = f"no formula uses the feature '{feature.name}'; add one, or remove it"
                yield warning_at(self._place('features', feature.name), text)
        texts = {*inputs.refused, *(each.requested.text for each in inputs.formulas)}
        for section, name in inputs.places:
            if section == 'constants' and not _is_in(name, texts):
                text = f"no formula uses the constant '{name}'; remove it"
                yield warning_at(inputs.places[section, name], text)

    def _used_concepts(self, knowledge: Knowledge) -> set[str]:
        symbols = (each for formula in self._inputs.formulas for each in symbols_of(formula))
        used: set[str] = set()
        for each in symbols:
            if each.kind is SymbolKind.FEATURE and not each.is_reference:
                with suppress(DyKnowError):  # Unknown names are reported elsewhere.
                    used.add(knowledge.feature(each.name).name)
                    if bound := ForecastFeature.of(each.name):
                        used.add(knowledge.feature(bound.feature).name)
        return used

    def _place(self, section: str, name: str) -> FilePlace:
        places = self._inputs.places
        first = next(iter(self._inputs.files.ontologies), 'ontology')
        return places.get((section, name), places.get(('sorts', name), FilePlace(str(first))))


def _unit_findings(formula: PlacedFormula, grounded: GroundedFormula) -> Iterator[Finding]:
    units = grounded.units
    for one, other in mixed_units(parse_formula(grounded.formula), units):
        text = (
            f"'{one.name}' is in {units[one.name]} and '{other.name}' in {units[other.name]}, and "
            'their values are compared as plain numbers; declare both in one unit, or convert one '
            'by a factor'
        )
        yield warning_at(formula.place(_mentioned(text, formula.requested.text)), text)


def _is_in(name: str, texts: Iterable[str]) -> bool:
    """Return True if a name is a word of a text."""
    return any(re.search(rf'\b{re.escape(name)}\b', each) for each in texts)


def annotations_of(inputs: LintInputs) -> Iterator[tuple[TextSource, Annotation]]:
    """Yield the annotations with the texts that they are in."""
    for source in inputs.files.annotations:
        for each in parse_annotations(read_text(source, 'annotations', ConfigurationError)):
            yield source, each


def streams_of(inputs: LintInputs) -> Iterator[tuple[FilePlace, StreamDeclaration]]:
    """Yield the declarations of streams with their places."""
    for source in inputs.files.streams:
        begin = inputs.place_of(source)
        text = read_text(source, 'streams', ConfigurationError)
        for each in parse_specification(text).declared(StreamDeclaration):
            yield begin if isinstance(source, InlineText) else begin.moved(each.position), each


def symbols_of(formula: PlacedFormula) -> tuple[Symbol, ...]:
    """Return the symbols of a formula."""
    requested, group = formula.requested, FormulaGroup()
    group.add_formula('formula', requested.text, requested.constants)
    return tuple(group.symbols())


def references_of(formula: PlacedFormula) -> Iterator[tuple[str, str]]:
    """Yield the topics that a formula names, with their fields."""
    for source, field in sources_of(formula):
        if isinstance(source, StreamReference) and source.is_topic:
            yield absolute_topic(source.name), field


def sources_of(formula: PlacedFormula) -> Iterator[tuple[Term, str]]:
    """Yield the topics, streams and built-in sources that a formula names, with their fields."""
    for each in symbols_of(formula):
        if each.is_reference:
            source, field = each.reference
            with suppress(DyKnowError):  # Built-in sources that there are not: reported elsewhere.
                yield made(parse_specification(f'sink {source}')), field


def stream_findings(inputs: LintInputs, contents: Contents) -> Iterator[Finding]:
    """Yield the streams that cannot be made; one may be made of another that comes later."""

    def source_type(topic: str) -> SourceType | None:
        content = contents.get(absolute_topic(topic))
        return None if content is None else SourceType(content.fields, not content.has_stamp)

    flow = Dataflow(load_units(), source_type)
    try:
        waiting = {
            each.name: (source, parse_specification(each.specification))
            for source in inputs.files.streams
            for each in read_streams([source])
        }
        list(read_streams(inputs.files.streams))  # Raises an error for two of one name.
    except DyKnowError as error:
        yield error_at(FilePlace('streams'), error)
        return
    faults: dict[str, DyKnowError] = {}
    while True:
        count = len(waiting)
        for name, (_, specification) in list(waiting.items()):
            try:
                flow.create(name, specification, NO_CONSTRAINTS)
                del waiting[name]
            except DyKnowError as error:
                faults[name] = error
        if len(waiting) == count:
            break
    for name, (source, _) in waiting.items():
        text = f"stream '{name}': {_reason(faults[name])}"
        yield error_at(_stream_place(inputs, source, name), text)


def _stream_place(inputs: LintInputs, source: TextSource, name: str) -> FilePlace:
    """Return where a text, or a template for objects, defines a stream; or where it begins."""
    place = inputs.place_of(source)
    # Names without placeholders first.
    for found in sorted(_DEFINED.finditer(place.text), key=lambda each: '{' in each[1]):
        pattern = r'\w+'.join(map(re.escape, re.split(r'\{[^{}]*\}', found[1])))
        if re.fullmatch(pattern, name):
            return replace(place, position=position_at(place.text, found.start()))
    return place


def _ontology_findings(inputs: LintInputs) -> Iterator[Finding]:
    """Yield the ontologies that cannot be loaded, and what others state in vain."""
    places: dict[str, FilePlace] = {}
    with Ontology() as ontology:
        for source in inputs.files.ontologies:
            try:
                if isinstance(source, InlineText):
                    ontology.load_text(source.text)
                else:
                    ontology.load(source)
            except DyKnowError as error:
                yield error_at(FilePlace(str(source)), error)
                continue
            for text in void_statements(ontology.triples, ontology.knowledge):
                places.setdefault(text, FilePlace(str(source)))
        # A later file may define what an earlier one names.
        remaining = set(void_statements(ontology.triples, ontology.knowledge)) if places else set()
    yield from (warning_at(place, text) for text, place in places.items() if text in remaining)


def _reason(error: DyKnowError) -> str:
    """Return an error in a line."""
    if isinstance(error, LanguageError):
        return error.reason
    return '; '.join(error.message.split('\n')[:2])


def _mentioned(message: str, text: str) -> int:
    """Return where a formula has what a message is about; 0 if it has none.

    That is a name, a feature, or a number with its unit, which is in quotes in a canonical text.
    """
    for found in _NAMED.finditer(message.partition('\n')[0]):
        name = re.escape(found['name'] or found['feature'] or found['number'])
        unit = rf'\s*"?{re.escape(found["unit"])}' if found['unit'] else r'\b'
        place = re.search(rf'\b{name}{unit}', text)
        if place is not None:
            return place.start()
    return 0
