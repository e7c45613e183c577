"""Values that are kept: `let v = Speed in eventually[0 s, 3 s] Speed < v - 1`.

At each state, `let` stands for its formula with the present value as a constant. So `let` has the
slot of an atom, and progression replaces the slot by this formula (`Progression.begin`). The atoms
of the formula have slots of their own for as long as it is open. Example, `always (p -> let ...)`
with a state each second; atom 2 is `p`, and the last column omits the `always`:

    state             slot of `let` is           atoms                  what remains
    0: p, Speed = 5   eventually[0 s, 3 s] 3     3: Speed < 5 - 1       eventually[to 3 s] 3
    1: p, Speed = 6   eventually[0 s, 3 s] 4     3, 4: Speed < 6 - 1    the same and [to 4 s] 4
    2: Speed = 4.5    eventually[0 s, 3 s] 5     3, 4, 5: ... 4.5 - 1   eventually[to 3 s] 3
    3: Speed = 3      eventually[0 s, 3 s] 4     3, 4: Speed < 3 - 1    nothing

Equal values share an atom, and free slots are used again, so the automaton has few locations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import reduce
from operator import or_
from typing import cast

from dyknow_common import ExitCode, Value, shortened
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.automata.automaton import MAX_SLOTS
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.language.constants import literal_of
from dyknow_reasoning.language.formula import Atom, Freeze
from dyknow_reasoning.progression.atoms import Predicate, Values, predicate, term_reader
from dyknow_reasoning.progression.instances import Translator, with_kept
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Node, slots


class KeptReader:
    """Reader of the atoms of an instance that keeps values; see `readers`.

    Args:
        instance: the instance, whose atoms it changes.
        template: its template.
        nodes: returns the possible remaining formulas of the instance.
    """

    def __init__(
        self, instance: FormulaInstance, template: Template, nodes: Callable[[], Iterable[Node]]
    ) -> None:
        self._instance, self._template, self._nodes = instance, template, nodes
        self._table = _AtomTable(cast('list[Atom]', instance.atoms))
        self._predicates: dict[str, Predicate] = {}

    def __call__(self, values: Values) -> int:
        """Return the symbol of a state.

        Raises:
            ReasoningError: if the values are unusable, or too many are kept.
        """
        try:
            return self._symbol(values)
        except UnusableValueError as error:
            mend = "leave out the 'let', which cannot keep it" if error.if_unknown else ''
            raise UnusableValueError(error.fault, mend) from None

    def _symbol(self, values: Values) -> int:
        automaton, table = self._template.automaton, self._table
        mask = reduce(or_, (node.mask for node in self._nodes()), 0)
        table.used = mask | self._instance.node.mask
        kept: dict[int, Node] = {}
        while pending := [slot for slot in table.freezes(mask) if slot not in kept]:
            for slot in pending:
                freeze = cast('Freeze', table.atoms[slot])
                read = term_reader(freeze.term, self._instance.kinds)
                body = with_kept(freeze.body, freeze.name, literal_of(_plain(read(values))))
                kept[slot] = _KeptTranslator(automaton.store, table).node(body, {})
                mask |= kept[slot].mask
        if mask.bit_length() > MAX_SLOTS:
            raise self._too_many()
        truth = sum(
            1 << slot for slot in slots(mask) if slot not in kept and self._holds(slot, values)
        )
        return automaton.symbol(truth, kept)

    def _holds(self, slot: int, values: Values) -> bool:
        name = self._table.names[slot]
        holds = self._predicates.get(name)
        if holds is None:
            if len(self._predicates) > 2 * MAX_SLOTS:
                self._predicates.clear()
            holds = self._predicates[name] = predicate(
                self._table.atoms[slot], self._instance.kinds
            )
        return holds(values)

    def _too_many(self) -> ReasoningError:
        freeze = next(each for each in self._table.atoms if isinstance(each, Freeze))
        return ReasoningError(
            f"'{shortened(freeze)}' keeps values of too many states at once, with more than "
            f'{MAX_SLOTS} comparisons; shorten its intervals, or write when to keep a value, '
            'p -> let ...',
            ExitCode.UNAVAILABLE,
        )


class _AtomTable:
    """The atoms of an instance, by their slots.

    Args:
        atoms: at first, the atoms of its formula.
    """

    def __init__(self, atoms: list[Atom]) -> None:
        self.atoms = atoms
        self.names = list(map(str, atoms))
        self.used = 0
        """The slots that are not free, as bits."""
        self._slots: dict[str, int] = {}
        for slot, name in enumerate(self.names):
            self._slots.setdefault(name, slot)

    def freezes(self, mask: int) -> Iterator[int]:
        """Return those slots of a mask that stand for a formula about a kept value."""
        return (slot for slot in slots(mask) if isinstance(self.atoms[slot], Freeze))

    def slot(self, atom: Atom) -> int:
        """Return the slot of an atom, a free one if it has none."""
        name = str(atom)  # The text tells 1 from 1.0; comparing atoms does not.
        slot = self._slots.get(name)
        if slot is None or not (self.used >> slot & 1 and self.names[slot] == name):
            slot = (~self.used & (self.used + 1)).bit_length() - 1
            self._put(slot, atom, name)
        self.used |= 1 << slot
        return slot

    def _put(self, slot: int, atom: Atom, name: str) -> None:
        missing = slot + 1 - len(self.atoms)
        self.atoms += [atom] * missing
        self.names += [''] * missing
        if self._slots.get(self.names[slot]) == slot:
            del self._slots[self.names[slot]]
        self.atoms[slot], self.names[slot], self._slots[name] = atom, name, slot


class _KeptTranslator(Translator):
    """Translates a formula with a kept value to nodes over the atoms of a table."""

    def __init__(self, store: NodeStore, table: _AtomTable) -> None:
        super().__init__(store, {})
        self._table = table

    def _slot(self, atom: Atom) -> int:
        return self._table.slot(atom)


def _plain(value: Value) -> Value:
    """Return a value without the type of a library."""
    if isinstance(value, float):
        return float(value)
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else value
