"""Semantic matching: which streams carry what a concept means (paper, section V)."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import chain, count, product
from math import inf
from typing import TYPE_CHECKING

from dyknow_semantics.annotation import feature_text
from dyknow_semantics.checking import check_annotation, check_concept
from dyknow_stream_processing import (
    Condition,
    LanguageError,
    Reference,
    Select,
    Selection,
    StreamDeclaration,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from dyknow_semantics.annotation import Annotation, Concept, Content, FeatureTerm, Range
    from dyknow_semantics.knowledge import Knowledge


@dataclass(frozen=True, slots=True)
class Match:
    """A stream of one ground feature.

    Args:
        ground_feature: what it carries, which is also the name of its only field: `Power[uav1]`.
        declaration: how it is made of the annotated stream.
        exact: whether the annotation is of the feature that was asked for or an equivalent one,
            not of one below it.
        reason: why the annotated stream matches.
    """

    ground_feature: str
    declaration: StreamDeclaration
    exact: bool
    reason: str

    @property
    def stream_name(self) -> str:
        """The name of the stream, which no other match of the same answer has."""
        return self.declaration.name

    @property
    def specification(self) -> str:
        """The text in the stream language, the reason as a comment before it."""
        return f'# {self.reason}\n{self.declaration};'


def match(
    concept: Concept, annotations: Iterable[Annotation], knowledge: Knowledge
) -> tuple[Match, ...]:
    """The streams that carry a concept, one for each ground feature of each annotated field.

    An annotation that makes no sense, such as of an object that is gone, matches nothing.

    Returns:
        Exact matches before others, then those of a shorter sample period before others, then of
        a shorter delay, then by name.

    Raises:
        LanguageError: if the concept makes no sense relative to the ontology.
    """
    check_concept(concept, knowledge)
    asked = _pattern(concept.feature, concept.ranges, knowledge)
    below = knowledge.subconcepts(asked.feature)
    found = [
        each
        for offer in _offers(annotations, knowledge)
        if offer.pattern.feature in below
        for each in _matches(concept.feature.name, asked, offer, knowledge)
    ]
    return _with_unique_names(sorted(found, key=_preference))


def nearest(concept: Concept, annotations: Iterable[Annotation], knowledge: Knowledge) -> str:
    """A sentence on what of the annotations comes nearest to a concept that nothing matches.

    Raises:
        LanguageError: if the concept makes no sense relative to the ontology.
    """
    check_concept(concept, knowledge)
    asked = _pattern(concept.feature, concept.ranges, knowledge)
    lack = f'no stream carries {concept}'
    if not all(asked.domains):
        return f'{lack}, since there are no objects of its sort'
    offers = list(_offers(annotations, knowledge))
    if not offers:
        return f'{lack}, since no stream is annotated'
    related = {
        (_distance(asked, offer.pattern, knowledge), str(offer))
        for offer in offers
        if _is_related(asked.feature, offer.pattern.feature, knowledge)
    }
    if related:
        return f'{lack}; nearest: {min(related)[1]}'
    carried = sorted({offer.pattern.feature for offer in offers})
    return f'{lack}; the annotated streams carry {", ".join(carried)}'


@dataclass(frozen=True, slots=True)
class _Pattern:
    """The ground features that a feature with variables stands for.

    Args:
        feature: its shortest name.
        arguments: the shortest names of objects, and variables, marked by `?`.
        domains: the objects that may stand at each place.
    """

    feature: str
    arguments: tuple[str, ...]
    domains: tuple[frozenset[str], ...]

    def covers(self, objects: tuple[str, ...]) -> bool:
        """Whether the feature of some objects is one of the ground features."""
        binding: dict[str, str] = {}
        return all(
            each in domain and binding.setdefault(argument, each) == each
            for each, argument, domain in zip(objects, self.arguments, self.domains, strict=True)
        )

    def bindings(self, other: _Pattern) -> Iterator[dict[str, str]]:
        """The objects that arguments stand for, where each is possible in the other pattern too."""
        choices: dict[str, frozenset[str]] = {}
        for argument, own, others in zip(self.arguments, self.domains, other.domains, strict=True):
            choices[argument] = choices.get(argument, own) & others
        for objects in product(*map(sorted, choices.values())):
            yield dict(zip(choices, objects, strict=True))


@dataclass(frozen=True, slots=True)
class _Offer:
    """One annotated field of a stream."""

    annotation: Annotation
    content: Content
    pattern: _Pattern

    def __str__(self) -> str:
        arguments = {argument.name for argument in self.content.feature.arguments}
        ranges = [each for each in self.annotation.ranges if each.variable in arguments]
        every = f' for every {", ".join(map(str, ranges))}' if ranges else ''
        return f'{self.source} carries {self.content.feature}{every}'

    @property
    def source(self) -> Reference:
        """The stream as the stream language refers to it."""
        return Reference(self.annotation.stream, self.annotation.is_topic)


def _offers(annotations: Iterable[Annotation], knowledge: Knowledge) -> Iterator[_Offer]:
    for annotation in annotations:
        try:
            check_annotation(annotation, knowledge)
        except LanguageError:
            continue
        for content in annotation.contents:
            pattern = _pattern(content.feature, annotation.ranges, knowledge)
            yield _Offer(annotation, content, pattern)


def _pattern(term: FeatureTerm, ranges: Iterable[Range], knowledge: Knowledge) -> _Pattern:
    feature = knowledge.feature(term.name)
    sorts = {each.variable: each.sort for each in ranges}
    names = [argument.name for argument in term.arguments]
    if not names:
        # A variable for each place: all that the feature can take.
        names = [str(place) for place, _ in enumerate(feature.argument_sorts)]
        sorts = dict(zip(names, feature.argument_sorts, strict=True))
    arguments = [f'?{name}' if name in sorts else knowledge.instance(name) for name in names]
    domains = [
        frozenset(knowledge.instances(sorts[name]) if name in sorts else (argument,))
        for name, argument in zip(names, arguments, strict=True)
    ]
    return _Pattern(feature.name, tuple(arguments), tuple(domains))


def _matches(name: str, asked: _Pattern, offer: _Offer, knowledge: Knowledge) -> Iterator[Match]:
    """The matches of what was asked for, under a name, with one annotated field."""
    exact = asked.feature in knowledge.subconcepts(offer.pattern.feature)
    for binding in offer.pattern.bindings(asked):
        objects = tuple(binding[argument] for argument in offer.pattern.arguments)
        if asked.covers(objects):
            ground = feature_text(name, objects)
            reason = _reason(asked.feature, ground, offer, exact=exact)
            yield Match(ground, _declaration(ground, offer, binding), exact, reason)


def _reason(asked: str, ground: str, offer: _Offer, *, exact: bool) -> str:
    carried = offer.pattern.feature
    if not exact:
        return f'subsumed: {carried} is below {asked}'
    if carried != asked:
        return f'exact match: {carried} is equivalent to {asked}'
    return f'exact match: {offer.source} carries {ground}'


def _declaration(ground: str, offer: _Offer, binding: Mapping[str, str]) -> StreamDeclaration:
    conditions = tuple(
        Condition(key.field, '=', binding[f'?{key.variable}'])
        for key in offer.annotation.keys
        if f'?{key.variable}' in binding
    )
    stream = Select(
        (Selection(offer.content.field, ground),),
        offer.source,
        conditions,
        constraints=offer.annotation.constraints,
    )
    name = '_'.join(map(_word, (ground, 'from', offer.annotation.stream)))
    return StreamDeclaration(name, stream)


def _word(text: str) -> str:
    return re.sub('[^A-Za-z0-9]+', '_', text).strip('_')


def _preference(match: Match) -> tuple[bool, float, float, str]:
    constraints = match.declaration.stream.constraints
    return (
        not match.exact,
        inf if constraints.sample_period is None else constraints.sample_period,
        inf if constraints.max_delay is None else constraints.max_delay,
        str(match.declaration),
    )


def _with_unique_names(matches: Iterable[Match]) -> tuple[Match, ...]:
    """The same matches; a stream whose name is taken already gets a number."""
    taken: set[str] = set()
    result: list[Match] = []
    for each in matches:
        names = chain([each.stream_name], (f'{each.stream_name}_{n}' for n in count(2)))
        name = next(name for name in names if name not in taken)
        taken.add(name)
        result.append(replace(each, declaration=replace(each.declaration, name=name)))
    return tuple(result)


def _is_related(asked: str, carried: str, knowledge: Knowledge) -> bool:
    """Whether two features lie below a common one, besides the top of all features."""
    features = {feature.name for feature in knowledge.features}
    common = set(knowledge.superconcepts(asked)) & set(knowledge.superconcepts(carried))
    return bool(common & features)


def _distance(asked: _Pattern, carried: _Pattern, knowledge: Knowledge) -> tuple[bool, bool, int]:
    """The lack of a match: of another feature, of one that is not even above, of objects."""
    other = carried.feature not in knowledge.subconcepts(asked.feature)
    beside = carried.feature not in knowledge.superconcepts(asked.feature)
    missed = sum(
        one.isdisjoint(other) for one, other in zip(asked.domains, carried.domains, strict=False)
    )
    return other, other and beside, missed
