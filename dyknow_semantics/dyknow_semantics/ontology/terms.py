"""What an ontology says in vain: terms that the upper ontology lacks, individuals of features."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Final

from dyknow_common import shortened
from dyknow_semantics.ontology import vocabulary
from dyknow_semantics.ontology.documents.sources import upper_ontology
from dyknow_semantics.ontology.knowledge import Knowledge, Triple
from dyknow_semantics.ontology.names import split_iri, suggestion

_NEAR: Final = re.compile(r'https?://(?:www\.)?dyknow\.org/ontology[#/]', re.IGNORECASE)
"""The namespace of the upper ontology, and those that are easily written for it."""


def void_statements(triples: Iterable[Triple], knowledge: Knowledge) -> Iterator[str]:
    """Yield why some statements of an ontology have no effect, as messages with advice."""
    triples = tuple(triples)
    upper, known = vocabulary.UPPER_ONTOLOGY, {each: each for each in _upper_terms()}
    # Others may define classes and individuals in this namespace, but no property has a meaning.
    defined = {
        subject
        for subject, predicate, kind in triples
        if predicate == vocabulary.TYPE and not kind.endswith('Property')
    }
    found = {each for triple in triples for each in triple if _NEAR.match(each)} - defined
    named = sorted(each for each in map(split_iri, found) if each[1] and _NEAR.fullmatch(each[0]))
    for namespace, name in named:
        is_argument = re.fullmatch(r'argument[1-9]\d*', name)
        if namespace == upper and name not in known and not is_argument:
            hint = suggestion(name, known)
            yield f"DyKnow's ontology has no term '{shortened(name)}'{hint}"
    for namespace in sorted({namespace for namespace, _ in named} - {upper}):
        yield (
            f'what the namespace {shortened(namespace)} names has no meaning; did you mean '
            f"DyKnow's namespace, {upper}?"
        )
    for each in knowledge.instances(vocabulary.FEATURE):
        concept = knowledge.concepts(each)[0]
        yield f"'{each}' is an individual of the feature '{concept}', which has none; remove it"


@cache
def _upper_terms() -> frozenset[str]:
    return frozenset(re.findall(r'rdf:about="#(\w+)"', upper_ontology().decode()))
