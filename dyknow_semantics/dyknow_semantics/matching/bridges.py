"""Bridge rules between ontologies, such as those of several robots (paper, section V; C-OWL).

`robot2:height equivalent uav:Altitude` says that two features, or two sorts, mean the same;
`robot2:Drone into uav:UAV` that whatever is of the first is of the second, and not the other way
round; `robot2:self same uav:uav2` that two names are those of one object.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable
from enum import StrEnum
from typing import Any, Final

from lark import Token, Transformer, v_args

from dyknow_common import NOWHERE, Language, LanguageError, TextPosition
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import differences
from dyknow_semantics.ontology.knowledge import Knowledge, Triple
from dyknow_semantics.ontology.vocabulary import EQUIVALENT_CLASS, SAME_AS, SUBCLASS_OF

LANGUAGE: Final = 'bridges'
"""What a text of bridge rules is called in messages."""

_BARE = re.compile(
    r'(?!(?:equivalent|into|same)\b)[A-Za-z_]\w*(:[A-Za-z_]\w*)?', re.ASCII
)  # fmt: skip


class Relation(StrEnum):
    """How the first name of a bridge rule relates to the second."""

    EQUIVALENT = 'equivalent'
    INTO = 'into'
    SAME = 'same'


_PREDICATES: Final = {
    Relation.EQUIVALENT: EQUIVALENT_CLASS,
    Relation.INTO: SUBCLASS_OF,
    Relation.SAME: SAME_AS,
}


@dataclasses.dataclass(frozen=True, slots=True)
class Bridge:
    """A bridge rule, `robot2:Drone into uav:UAV`.

    Args:
        source: a name in one ontology.
        relation: what it is to the other name.
        target: a name in another ontology.
        text: what was parsed, for error messages.
    """

    source: str
    relation: Relation
    target: str
    source_place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    target_place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'{_name_text(self.source)} {self.relation} {_name_text(self.target)};'


def parse_bridges(text: str) -> tuple[Bridge, ...]:
    """The bridge rules of a text, which `;` separates.

    Raises:
        LanguageError: with the place and what was expected there.
    """
    return tuple(dataclasses.replace(bridge, text=text) for bridge in _BRIDGES.parse(text))


def bridge_triple(bridge: Bridge, knowledge: Knowledge) -> Triple:
    """What a bridge adds to the ontologies that it joins, as an RDF triple.

    Raises:
        LanguageError: with the place, for an unknown name, two names of different kinds, or two
            features of which one cannot stand in for the other.
    """
    if bridge.relation is Relation.SAME:
        names = knowledge.instance_names
    else:
        names = knowledge.concept_names
    iris = []
    for name, place in (
        (bridge.source, bridge.source_place),
        (bridge.target, bridge.target_place),
    ):
        try:
            iris.append(names.iri(name))
        except SemanticsError as error:
            raise LanguageError(error.message, LANGUAGE, bridge.text, place, error.code) from None
    if bridge.relation is not Relation.SAME:
        _check_kinds(bridge, knowledge)
    return iris[0], _PREDICATES[bridge.relation], iris[1]


@dataclasses.dataclass(frozen=True, slots=True)
class Bridged:
    """Ontologies and the bridges between them.

    Args:
        stated: what the ontologies say by themselves.
        known: the same, and what follows over the bridges.
        faults: what is wrong with bridges that make no sense; they are left out.
    """

    stated: Knowledge
    known: Knowledge
    faults: tuple[str, ...] = ()


def bridged(triples: Iterable[Triple], bridges: Iterable[Bridge]) -> Bridged:
    """What ontologies say by themselves, and with the bridges between them.

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
        raise LanguageError(fault, LANGUAGE, bridge.text, bridge.source_place)


def _name_text(name: str) -> str:
    return name if _BARE.fullmatch(name) else json.dumps(name, ensure_ascii=False)


@v_args(inline=True)
class _BridgeBuilder(Transformer[Any]):
    """Makes the abstract syntax; one method for each rule of the grammar."""

    def start(self, *bridges: Bridge) -> tuple[Bridge, ...]:
        return bridges

    def bridge(self, source: Token, relation: Token, target: Token) -> Bridge:
        return Bridge(
            _name(source),
            Relation(relation),
            _name(target),
            source_place=TextPosition.of(source),
            target_place=TextPosition.of(target),
        )


def _name(token: Token) -> str:
    return str(json.loads(token)) if token.type == 'QUOTED' else str(token)


_BRIDGES: Final[Language[tuple[Bridge, ...]]] = Language(
    LANGUAGE,
    __package__,
    'bridges.lark',
    _BridgeBuilder(),
    {
        'NAME': 'a name',
        'QUOTED': 'a quoted name',
        'RELATION': 'equivalent, into or same',
    },
)
