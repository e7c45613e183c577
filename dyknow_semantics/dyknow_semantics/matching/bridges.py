"""Bridge rules between ontologies, such as those of several robots (paper, section V; C-OWL).

`robot2:height equivalent uav:Altitude`: two features, or two sorts, mean the same;
`robot2:Drone into uav:UAV`: each instance of the first is one of the second, but not vice versa;
`robot2:self same uav:uav2`: two names of one object.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from enum import StrEnum
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
from dyknow_semantics.ontology.vocabulary import EQUIVALENT_CLASS, SAME_AS, SUBCLASS_OF


class Relation(StrEnum):
    """The relation of the first name of a bridge rule to the second."""

    EQUIVALENT = 'equivalent'
    INTO = 'into'
    SAME = 'same'


_PREDICATES: Final = {
    Relation.EQUIVALENT: EQUIVALENT_CLASS,
    Relation.INTO: SUBCLASS_OF,
    Relation.SAME: SAME_AS,
}

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
        relation: of the first name to the second.
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
    """Return the RDF triple that a bridge adds to the ontologies that it joins.

    Raises:
        LanguageError: with the position, for an unknown name, two names of different kinds, or two
            features of which one cannot stand in for the other.
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
    return iris[0], _PREDICATES[bridge.relation], iris[1]


@dataclasses.dataclass(frozen=True, slots=True)
class Bridged:
    """Ontologies and the bridges between them.

    Args:
        stated: the knowledge of the ontologies without bridges.
        known: the same, with the consequences of the bridges.
        faults: messages about invalid bridges, which are left out.
    """

    stated: Knowledge
    known: Knowledge
    faults: tuple[str, ...] = ()


def bridged(triples: Iterable[Triple], bridges: Iterable[Bridge]) -> Bridged:
    """Return the knowledge of ontologies without and with the bridges between them.

    Raises:
        SemanticsError: if an ontology is malformed, or the ontologies contradict each other over
            several bridges.
    """
    all_triples = tuple(triples)
    stated = Knowledge(all_triples)
    added: list[Triple] = []
    faults: list[str] = []
    for bridge in bridges:
        try:
            added.append(bridge_triple(bridge, stated))
        except LanguageError as error:
            faults.append(error.message)
    known = Knowledge((*all_triples, *added)) if added else stated
    return Bridged(stated, known, tuple(faults))


def _check_kinds(bridge: Bridge, knowledge: Knowledge) -> None:
    features = [*filter(knowledge.is_feature, (bridge.source, bridge.target))]
    fault = ''
    if len(features) == 1:
        fault = f"'{features[0]}' is a feature and the other a sort"
    elif features:
        source, target = knowledge.feature(bridge.source), knowledge.feature(bridge.target)
        fault = ' and '.join(differences(source, target))
        if fault:
            fault = f"feature '{bridge.source}' {fault} as '{bridge.target}'"
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
