"""The symbols of formulas: what must be grounded before they can be evaluated."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from dyknow_reasoning.atoms import fields
from dyknow_reasoning.formula import (
    Exists,
    Feature,
    Forall,
    Formula,
    Object,
    Reference,
    Term,
    parts,
)
from dyknow_reasoning.nodes import slots
from dyknow_reasoning.parsing import parse_formula

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from dyknow_reasoning.grounding import Instance


class SymbolKind(IntEnum):
    """What a symbol is; the numbers are those of dyknow_interfaces/msg/Symbol."""

    FEATURE = 0
    SORT = 1
    OBJECT = 2


@dataclass(frozen=True, slots=True)
class Symbol:
    """A feature, a sort or an object that a formula mentions.

    Args:
        kind: which of them.
        name: of a syntactic reference, its canonical text, `uav1_power.power`.
        arguments: of a feature; an object, or the sort that the variable there ranges over.
    """

    kind: SymbolKind
    name: str
    arguments: tuple[str, ...] = ()

    @property
    def field(self) -> str:
        """The name of the field that holds a ground feature in a state: `XYDist[uav1, uav2]`."""
        return str(Feature(self.name, tuple(map(Object, self.arguments))))

    @property
    def reference(self) -> Reference | None:
        """The stream and field of a syntactic reference; None for what is named by its meaning."""
        if '.' not in self.name:
            return None
        reference = parse_formula(self.name)
        return reference if isinstance(reference, Reference) else None


def symbols_of(formula: Formula) -> list[Symbol]:
    """The symbols of a formula in the order of its text, each once."""
    return list(dict.fromkeys(_symbols(formula, {})))


def ground_symbols(instances: Iterable[Instance]) -> list[Symbol]:
    """The ground features that instances still depend on, each once."""
    atoms = (instance.atoms[slot] for instance in instances for slot in slots(instance.node.mask))
    return list(dict.fromkeys(_feature(field, {}) for atom in atoms for field in fields(atom)))


def _symbols(node: Formula | Term, sorts: Mapping[str, str]) -> Iterator[Symbol]:
    match node:
        case Feature() | Reference():
            yield _feature(node, sorts)
        case Object(name):
            yield Symbol(SymbolKind.OBJECT, name)
        case Forall(variable, sort) | Exists(variable, sort):
            yield Symbol(SymbolKind.SORT, sort)
            sorts = {**sorts, variable: sort}
    for part in parts(node):
        yield from _symbols(part, sorts)


def _feature(node: Feature | Reference, sorts: Mapping[str, str]) -> Symbol:
    if isinstance(node, Reference):
        return Symbol(SymbolKind.FEATURE, str(node))
    arguments = tuple(sorts.get(argument.name, argument.name) for argument in node.arguments)
    return Symbol(SymbolKind.FEATURE, node.name, arguments)
