"""The values of past terms for those who calculate with them, such as margins."""

from __future__ import annotations

from collections.abc import Sequence

from dyknow_reasoning.execution.past.histories import Histories
from dyknow_reasoning.execution.past.past_comparisons import past_terms, value_field
from dyknow_reasoning.language.formula import Comparison, PastAtom
from dyknow_reasoning.language.terms import Truth
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.bounds import Chronology
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.node_store import NodeStore


class PastValues:
    """The values of the past terms of some comparisons, by their texts.

    Args:
        comparisons: the comparisons, without variables.
        kinds: the kinds of their features.
    """

    def __init__(self, comparisons: Sequence[Comparison], kinds: Kinds) -> None:
        store = NodeStore(Chronology())
        literals = [store.literal(slot, positive=True) for slot in range(len(comparisons))]
        asked = Instance(
            {}, tuple(map(PastAtom, comparisons)), store.junction(literals, universal=True)
        )
        self._histories = Histories(0)
        (found,) = self._histories.attach(0, Truth(True), [asked], kinds)
        self._fields = {
            str(term): value_field(atom, term)
            for atom in found.atoms
            if isinstance(atom, PastAtom) and isinstance(atom.formula, Comparison)
            for term in past_terms(atom.formula)
        }

    def extended(self, time: int, values: Values) -> Values:
        """Return the values of a state and of the past terms: an error if it is not known."""
        found = self._histories.extended(time, values)
        return {**values, **{text: found[field] for text, field in self._fields.items()}}

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._histories.gap()
