"""Bridge rules between ontologies, for example of several robots (paper, section V; C-OWL).

`robot2:height equivalent uav:Altitude`: two features, or two sorts, mean the same;
`robot2:Drone into uav:UAV`: each instance of the first is one of the second, but not vice versa;
`robot2:self same uav:uav2`: two names of one object.

An ontology may state the same, with the properties `into`, `equivalent` and `same` of the upper
ontology. The ontology manager states the rules of files so, in an ontology of their own, which all
nodes receive with the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from enum import StrEnum
from itertools import chain
from typing import Any, Final

from lark import Token

from dyknow_common import (
    NOWHERE,
    Language,
    LanguageError,
    SyntaxBuilder,
    TextPosition,
    builder,
    text_value,
)
from dyknow_semantics.ontology.features import differences
from dyknow_semantics.ontology.knowledge import Knowledge, Triple
from dyknow_semantics.ontology.vocabulary import (
    EQUIVALENT_CLASS,
    SAME_AS,
    SUBCLASS_OF,
    UPPER_ONTOLOGY,
)


class Relation(StrEnum):
    """The relation of the first name of a bridge rule to the second."""

    EQUIVALENT = 'equivalent'
    INTO = 'into'
    SAME = 'same'


_RELATIONS: Final = {f'{UPPER_ONTOLOGY}{each}': each for each in Relation}
"""The properties of the upper ontology that state bridges."""

_CONSEQUENCES: Final = {
    f'{UPPER_ONTOLOGY}equivalent': EQUIVALENT_CLASS,
    f'{UPPER_ONTOLOGY}into': SUBCLASS_OF,
    f'{UPPER_ONTOLOGY}same': SAME_AS,
}
"""For each of them, the predicate with the same consequences inside one ontology."""

LANGUAGE: Final = Language(
    'bridges',
    __package__,
    'bridges.lark',
    {'QUOTED': 'a quoted name', 'RELATION': 'equivalent, into or same'},
)


@dataclasses.dataclass(frozen=True, slots=True)
class Bridge:
    """A bridge rule, `robot2:Drone into uav:UAV`.

    Args:
        source: a name in one ontology.
        relation: the relation of the first name to the second.
        target: a name in another ontology.
        text: the parsed text, for error messages.
    """

    source: str
    relation: Relation
    target: str
    source_position: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    target_position: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def __str__(self) -> str:
        return (
            f'{LANGUAGE.name_text(self.source)} {self.relation} {LANGUAGE.name_text(self.target)};'
        )


def parse_bridges(text: str) -> tuple[Bridge, ...]:
    """Return the bridge rules of a text, which `;` separates.

    Raises:
        LanguageError: with the position and what was expected there.
    """
    rules = LANGUAGE.parse(text, _BridgeBuilder())
    return tuple(dataclasses.replace(bridge, text=text) for bridge in rules)


def bridge_triple(bridge: Bridge, knowledge: Knowledge) -> Triple:
    """Return the RDF triple that states a bridge.

    Raises:
        LanguageError: with the position, for an unknown name, two names of different kinds, or two
            features that cannot stand in for each other.
    """
    if bridge.relation is Relation.SAME:
        names = knowledge.instance_names
    else:
        names = knowledge.concept_names
    iris = []
    for name, position in (
        (bridge.source, bridge.source_position),
        (bridge.target, bridge.target_position),
    ):
        with LANGUAGE.errors_at(bridge.text, position):
            iris.append(names.iri(name))
    if bridge.relation is not Relation.SAME:
        _check_kinds(bridge, knowledge)
    return iris[0], f'{UPPER_ONTOLOGY}{bridge.relation}', iris[1]


@dataclasses.dataclass(frozen=True, slots=True)
class Bridged:
    """Ontologies and the bridges between them.

    Args:
        known: the knowledge of the ontologies, with the consequences of the bridges.
        statements: the triples that state the valid bridge rules.
        faults: messages about invalid bridges, which are left out.
    """

    known: Knowledge
    statements: tuple[Triple, ...] = ()
    faults: tuple[str, ...] = ()


def bridged(triples: Iterable[Triple], rules: Iterable[Bridge] = ()) -> Bridged:
    """Return the knowledge of ontologies with the bridges that they state, and bridge rules.

    Raises:
        SemanticsError: if an ontology is malformed, or the ontologies contradict each other over
            several bridges.
    """
    all_triples = tuple(triples)
    stated = Knowledge(all_triples)
    faults: list[str] = []
    statements = _valid(rules, stated, faults)
    texts = (
        str(Bridge(source, _RELATIONS[predicate], target))
        for source, predicate, target in all_triples
        if predicate in _RELATIONS
    )
    others = chain.from_iterable(map(parse_bridges, texts))
    bridges = *statements, *_valid(others, stated, faults)
    added = [(source, _CONSEQUENCES[relation], target) for source, relation, target in bridges]
    known = Knowledge((*all_triples, *added), stated) if added else stated
    return Bridged(known, statements, tuple(faults))


def _valid(
    bridges: Iterable[Bridge], knowledge: Knowledge, faults: list[str]
) -> tuple[Triple, ...]:
    """Return the triples that state valid bridges; append to `faults` why others are not."""
    found: list[Triple] = []
    for bridge in bridges:
        try:
            found.append(bridge_triple(bridge, knowledge))
        except LanguageError as error:
            faults.append(error.message)
    return tuple(found)


def _check_kinds(bridge: Bridge, knowledge: Knowledge) -> None:
    features = [*filter(knowledge.is_feature, (bridge.source, bridge.target))]
    fault = ''
    if len(features) == 1:
        fault = f"'{features[0]}' is a feature and the other a sort"
    elif features:
        source, target = bridge.source, bridge.target
        is_mutual = bridge.relation is Relation.EQUIVALENT
        for one, other in ((source, target), (target, source))[: 1 + is_mutual]:
            if found := differences(knowledge.feature(one), knowledge.feature(other)):
                fault = f"feature '{one}' {' and '.join(found)} as '{other}'"
                break
    if fault:
        raise LANGUAGE.error(fault, bridge.text, bridge.source_position)


@builder
class _BridgeBuilder(SyntaxBuilder[Any]):
    """The builder of the abstract syntax; it has a method for each rule of the grammar."""

    def start(self, *bridges: Bridge) -> tuple[Bridge, ...]:
        return bridges

    def bridge(self, source: Token, relation: Token, target: Token) -> Bridge:
        return Bridge(
            text_value(source),
            Relation(relation),
            text_value(target),
            source_position=TextPosition.of(source),
            target_position=TextPosition.of(target),
        )
