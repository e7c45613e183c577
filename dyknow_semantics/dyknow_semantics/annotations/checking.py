"""Checks of annotations and concepts against an ontology."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from dyknow_common import Language, StreamConstraints, ValueType, check_unit
from dyknow_semantics.annotations.annotation import (
    ANNOTATION,
    CONCEPT,
    Annotation,
    Concept,
    Content,
    FeatureTerm,
    Range,
)
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import FeatureSignature, converts
from dyknow_semantics.ontology.knowledge import Knowledge


def check_annotation(annotation: Annotation, knowledge: Knowledge) -> None:
    """Check an annotation against an ontology.

    Raises:
        LanguageError: with the position, for an unknown feature, sort or object, a wrong number of
            arguments, an argument outside of its sort, or a unit that is unknown or does not
            convert to the feature's.
    """
    checker = _AnnotationChecker(ANNOTATION, annotation.text, knowledge)
    sorts = checker.sorts(annotation.ranges)
    for content in annotation.contents:
        feature = checker.feature(content.feature)
        checker.check_arguments(content.feature, feature, sorts)
        checker.check_unit(content, feature)
        checker.check_unknown(content, feature, annotation.constraints)


def check_concept(concept: Concept, knowledge: Knowledge) -> None:
    """Check a concept against an ontology.

    Raises:
        LanguageError: with the position, for an unknown feature, sort or object, a wrong number of
            arguments, or an argument outside of its sort.
    """
    checker = _AnnotationChecker(CONCEPT, concept.text, knowledge)
    sorts = checker.sorts(concept.ranges)
    feature = checker.feature(concept.feature)
    if concept.feature.arguments:
        checker.check_arguments(concept.feature, feature, sorts)


class _AnnotationChecker:
    """A check of the parts of one text against an ontology."""

    def __init__(self, language: Language, text: str, knowledge: Knowledge) -> None:
        self._at = partial(language.errors_at, text)
        self._knowledge = knowledge

    def sorts(self, ranges: Iterable[Range]) -> dict[str, str]:
        """Return the sort of each variable."""
        for each in ranges:
            with self._at(each.sort_position):
                self._knowledge.superconcepts(each.sort)
        return {each.variable: each.sort for each in ranges}

    def feature(self, term: FeatureTerm) -> FeatureSignature:
        """Return the feature that a term names."""
        with self._at(term.position):
            return self._knowledge.feature(term.name)

    def check_arguments(
        self, term: FeatureTerm, feature: FeatureSignature, sorts: Mapping[str, str]
    ) -> None:
        """Check that the arguments of a term are of the sorts of its feature."""
        expected = feature.argument_sorts
        with self._at(term.position):
            if len(term.arguments) != len(expected):
                raise SemanticsError(
                    f"feature '{feature.name}' takes {_count(expected)}, "
                    f'but has {len(term.arguments)} here'
                )
        for argument, sort in zip(term.arguments, expected, strict=True):
            with self._at(argument.position):
                if argument.name in sorts:
                    self._check_variable(argument.name, sorts[argument.name], sort)
                else:
                    self._check_object(argument.name, sort)

    def check_unknown(
        self, content: Content, feature: FeatureSignature, constraints: StreamConstraints
    ) -> None:
        """Check that the value of a field may be unknown in some samples, or after a gap."""
        cause = "have 'unless'" if content.unless is not None else 'expire'
        may_be_unknown = content.unless is not None or constraints.expires
        if may_be_unknown and feature.value_type not in {ValueType.INT, ValueType.FLOAT}:
            with self._at(content.feature.position):
                raise SemanticsError(
                    f"feature '{feature.name}' has values of the type {feature.value_type}; "
                    f'only numbers may {cause}'
                )

    def check_unit(self, content: Content, feature: FeatureSignature) -> None:
        """Check that the unit of a field converts to the one of its feature."""
        if content.unit is None or content.unit == feature.unit:
            return
        with self._at(content.unit_position):
            if not content.unit:
                raise SemanticsError('the unit is empty; write one, such as [m], or leave it out')
            check_unit(content.unit)
            if not feature.unit:
                raise SemanticsError(
                    f"feature '{feature.name}' is measured in no unit; leave it out"
                )
            if not converts(content.unit, feature.unit):
                raise SemanticsError(
                    f"feature '{feature.name}' is measured in {feature.unit}, "
                    f'which {content.unit} does not convert to'
                )

    def _check_variable(self, name: str, sort: str, expected: str) -> None:
        if expected not in self._knowledge.superconcepts(sort):
            raise SemanticsError(
                f"the variable '{name}' must range over '{expected}' or a sort below it, "
                f"but '{sort}' is none"
            )

    def _check_object(self, name: str, expected: str) -> None:
        try:
            concepts = self._knowledge.concepts(name)
        except SemanticsError as error:
            raise SemanticsError(
                f"'{name}' is no variable (add: for every {name} in {expected}) and no object: "
                f'{error}',
                error.code,
            ) from None
        if expected not in concepts:
            raise SemanticsError(f"'{name}' must be an instance of '{expected}', but is none")


def _count(sorts: tuple[str, ...]) -> str:
    if not sorts:
        return 'no arguments'
    plural = '' if len(sorts) == 1 else 's'
    return f'{len(sorts)} argument{plural} ({", ".join(sorts)})'
