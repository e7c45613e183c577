"""Checks of the names and signatures of new concepts and instances."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Final

from dyknow_common import (
    FORMULA_WORDS,
    FUNCTIONS,
    SSL_WORDS,
    ExitCode,
    ValueType,
    check_name,
    shortened,
)
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import StatedSignature
from dyknow_semantics.ontology.knowledge import Knowledge
from dyknow_semantics.ontology.names import split_iri
from dyknow_semantics.ontology.vocabulary import FEATURE, NULLARY_FEATURE, OBJECT

_CONCEPT: Final = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
_INSTANCE: Final = re.compile(r'[A-Za-z_][A-Za-z0-9_.-]*')
_IRI: Final = re.compile(r'[A-Za-z][A-Za-z0-9+.-]*:[^\s\x00-\x1f\x7f-\x9f<>"{}|\\^`]*')
"""An absolute IRI: its scheme as in RFC 3987, and none of the characters that no IRI has."""

_MAX_CONCEPTS: Final = 100
"""The number of parents of a concept, of its argument sorts, and of concepts of an instance."""

_NO_UNIT: Final = {ValueType.STRING, ValueType.BOOLEAN}


def new_iri(name: str, knowledge: Knowledge, namespaces: Iterable[str], default: str) -> str:
    """Return the IRI of a new concept or instance.

    Args:
        name: a short name, a prefixed one, or an IRI.
        knowledge: what exists.
        namespaces: the namespaces of the loaded ontologies.
        default: the namespace of a short name.

    Raises:
        SemanticsError: if the name exists, its prefix is unknown, or it is reserved; or for an IRI
            that is not absolute: reasoners would take it for another entity.
    """
    check_name(name, SemanticsError, f"'{shortened(name)}'")
    if name in knowledge.concept_names or name in knowledge.instance_names:
        raise SemanticsError(f"'{name}' already exists", ExitCode.ALREADY_EXISTS)
    if '/' in name:
        if not _IRI.fullmatch(name):
            raise SemanticsError(
                f"'{shortened(name)}' is neither a name nor an absolute IRI; leave out each /, "
                'or write an IRI such as https://example.org/fleet#boat1'
            )
        namespace, local = split_iri(name)
    else:
        namespace = default
        prefix, colon, local = name.rpartition(':')
        if colon:
            namespace = knowledge.prefixes.namespace(prefix, namespaces)
    if not _INSTANCE.fullmatch(local):
        raise SemanticsError(
            f"'{shortened(name)}' is not a valid name; it must begin with an ASCII letter or _, "
            'followed by ASCII letters, digits, _ . or -'
        )
    if local in FORMULA_WORDS | SSL_WORDS | FUNCTIONS:
        raise SemanticsError(
            f"'{local}' is a reserved word of formulas or annotations; choose another name"
        )
    return namespace + local


def check_number(concepts: Collection[str], kind: str) -> None:
    """Check the number of concepts in a request.

    Raises:
        SemanticsError: if there are too many.
    """
    if len(concepts) > _MAX_CONCEPTS:
        raise SemanticsError(
            f'there are {len(concepts):,} {kind}, more than {_MAX_CONCEPTS}; give fewer'
        )


def check_concept_name(iri: str) -> None:
    """Check that formulas can name a new concept.

    Raises:
        SemanticsError: if they cannot.
    """
    local = split_iri(iri)[1]
    if not _CONCEPT.fullmatch(local):
        raise SemanticsError(
            f"'{local}' is not a valid name of a concept, as formulas could not name it; "
            'use ASCII letters, digits and _ only'
        )


def checked_parents(
    name: str, parents: Collection[str], signature: StatedSignature, knowledge: Knowledge
) -> tuple[str, ...]:
    """Return the IRIs of the parents of a new concept; a feature without any is below Feature.

    Raises:
        SemanticsError: if a parent is unknown, or a feature has a sort for a parent.
    """
    check_number(parents, 'parents')
    iris = tuple(map(knowledge.concept_names.iri, parents))
    sorts = [parent for parent, iri in zip(parents, iris, strict=True) if _is_sort(iri, knowledge)]
    if sorts and len(sorts) < len(iris):
        features = ', '.join(parent for parent in parents if parent not in sorts)
        raise SemanticsError(
            f"'{name}' cannot be below both sorts ({', '.join(sorts)}) and features ({features}); "
            'give parents of one kind'
        )
    if sorts and signature:
        raise SemanticsError(
            f"the parent '{sorts[0]}' of the feature '{name}' is a sort; give features as parents, "
            'or none; a sort has no argument sorts, value type or unit'
        )
    return iris or ((FEATURE,) if signature else ())


def assumed_signature(
    name: str, parents: Collection[str], stated: StatedSignature, knowledge: Knowledge
) -> tuple[StatedSignature, str]:
    """Return the signature of a new concept, and a sentence about what it assumes, or ''.

    In the paper, a feature is made of its name and its parent `Feature` alone (section VI-A.3).

    Raises:
        SemanticsError: if a parent is unknown.
    """
    if stated or [*map(knowledge.concept_names.iri, parents)] != [FEATURE]:
        return stated, ''
    return StatedSignature((OBJECT,), ValueType.FLOAT), (
        f"assumed that the feature '{name}' has one argument of any sort, and float values without "
        'unit; to state others, give argument_sorts, value_type or unit, or a feature as parent'
    )


def checked_signature(
    name: str, parents: tuple[str, ...], stated: StatedSignature, knowledge: Knowledge
) -> StatedSignature:
    """Return the signature that a new feature states, with the IRIs of its argument sorts.

    Args:
        name: the name of the feature.
        parents: the IRIs of its parents.
        stated: its signature, with the names of its argument sorts.
        knowledge: what exists.

    Raises:
        SemanticsError: if an argument sort, the value type or the unit is invalid.
    """
    check_number(stated.argument_sorts, 'argument sorts')
    sorts = [
        _argument_sort(name, number, sort, knowledge)
        for number, sort in enumerate(stated.argument_sorts, 1)
    ]
    if sorts and NULLARY_FEATURE in parents:
        raise SemanticsError(
            f"the feature '{name}' is below NullaryFeature, and so has no arguments; "
            'place it below Feature, or leave out argument_sorts'
        )
    if stated.value_type not in {'', *ValueType}:
        raise SemanticsError(
            f"the value type '{shortened(stated.value_type)}' of the feature '{name}' is unknown; "
            f'give one of {", ".join(ValueType)}'
        )
    if stated.unit:  # Whether it is known is checked with the features of the result.
        _check_has_numbers(name, parents, stated, knowledge)
    return replace(stated, argument_sorts=tuple(sorts))


def _argument_sort(feature: str, number: int, sort: str, knowledge: Knowledge) -> str:
    try:
        iri = knowledge.concept_names.iri(sort)
    except SemanticsError as error:
        text = f"argument sort {number} of the feature '{feature}': {error.message}"
        raise SemanticsError(text, error.code) from None
    if not _is_sort(iri, knowledge):
        raise SemanticsError(
            f"argument sort {number} of the feature '{feature}': '{sort}' is a feature; give a sort"
        )
    return iri


def _check_has_numbers(
    name: str, parents: tuple[str, ...], stated: StatedSignature, knowledge: Knowledge
) -> None:
    features = (knowledge.feature(iri) for iri in parents if knowledge.is_feature(iri))
    types = {stated.value_type} if stated.value_type else {each.value_type for each in features}
    if types & _NO_UNIT:
        raise SemanticsError(
            f"the feature '{name}' has the unit '{stated.unit}', but its values are no numbers; "
            'leave out the unit, or give the value type float or int'
        )


def _is_sort(iri: str, knowledge: Knowledge) -> bool:
    return knowledge.name(iri) in knowledge.sorts
