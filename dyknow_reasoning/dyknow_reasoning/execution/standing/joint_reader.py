"""One reader for the atoms of all instances of a formula."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias, cast

from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.execution.automata.readers import (
    MAX_GENERATED,
    ReaderCode,
    careful_reader,
    quick_reader,
)
from dyknow_reasoning.progression.atoms import Predicate, Values, predicate
from dyknow_reasoning.progression.nodes import slots

JointReader: TypeAlias = Callable[[Values], tuple[int, ...]]
"""The truth of the atoms of each instance, as bits; raises ReasoningError for unusable values."""

_MAX_ATOMS = 2048
"""The most atoms of all instances: code for many takes long to compile."""


def joint_reader(instances: Sequence[FormulaInstance]) -> JointReader:
    """Return a reader of all atoms on which the fresh formulas of some instances depend."""
    predicates = [predicates_of(each) for each in instances]
    counts = [len(each) for each in predicates]
    if sum(counts) > _MAX_ATOMS or max(counts, default=0) > MAX_GENERATED:
        readers = [
            quick_reader(each.atoms, each.kinds, found)
            for each, found in zip(instances, predicates, strict=True)
        ]
        return lambda values: tuple(read(values) for read in readers)
    careful = [careful_reader(each) for each in predicates]
    source = ReaderCode()
    symbols = [
        source.symbol(each.atoms, each.kinds, found)
        for each, found in zip(instances, predicates, strict=True)
    ]
    return cast(
        'JointReader',
        source.reader(
            f'({"".join(f"{symbol}, " for symbol in symbols)})',
            lambda values: tuple(read(values) for read in careful),
        ),
    )


def predicates_of(instance: FormulaInstance) -> dict[int, Predicate]:
    """Return the predicates of the atoms on which a fresh formula depends, by their slots."""
    atoms, kinds = instance.atoms, instance.kinds
    return {slot: predicate(atoms[slot], kinds) for slot in slots(instance.node.mask)}
