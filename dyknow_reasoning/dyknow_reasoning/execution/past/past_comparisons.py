"""Comparisons with values of the past, as registers: `x - prev(x) < 5`, `count(p, 10 s) <= 3`.

At each state, the memories of the past terms give the values of the terms, inner terms first, and
take the values of their operands. Example, `prev(x)` and `count(x > 2, 2 s)`:

    time, s    x    prev(x)    count(x > 2, 2 s)
    0          1    none       0
    1          3    1          1
    2          4    3          2
    4          1    4          1, as 1 s is too long ago

After a gap, values that depend on missing states are not known: the comparison is false for the
least favourable states and true for the most favourable ones.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import ChainMap, deque
from collections.abc import Callable, Hashable, Iterator, MutableMapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Final, cast

from dyknow_common import ProbabilityInterval
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.past.registers import BOUNDS, PastRegister
from dyknow_reasoning.execution.probability.formula_probability import (
    AskedProbability,
    FormulaProbability,
)
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    PastAtom,
    PastFormula,
    Previous,
    parts,
)
from dyknow_reasoning.language.terms import PastTerm, Probability, StateCount, Term
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import (
    NoStateBeforeError,
    Values,
    field_name,
    fields,
    predicate,
    term_reader,
)
from dyknow_reasoning.progression.gaps import Gap, UnknowableError, unknowable
from dyknow_reasoning.progression.instances import PastOperands, past_operands
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import holds_at

MAX_COUNTED: Final = 100_000
"""The most states in the window of a count at which its formula held."""


def operands_of(formula: PastFormula | Comparison, store: NodeStore) -> list[PastOperands]:
    """Return the operands of a ground past operator, or of each count in a comparison."""
    if not isinstance(formula, Comparison):
        return [past_operands(formula, store)]
    asked = (each for each in past_terms(formula) if isinstance(each, _OF_FORMULAS))
    return [past_operands(Previous(each.body), store) for each in asked]


class ComparisonRegister(PastRegister):
    """A comparison with values of the past; the value of each past term has a field, too.

    Args:
        atom: the comparison, with the name of its field.
        operands: the operands of its counts and probabilities; past operators in them are atoms
            with fields, too.
        inner: the registers of these past operators.
        kinds: the kinds of the features.
    """

    memory: TermMemories

    def __init__(
        self,
        atom: PastAtom,
        operands: Sequence[PastOperands],
        inner: Sequence[PastRegister],
        kinds: Kinds,
    ) -> None:
        comparison = cast('Comparison', atom.formula)
        self._holds = predicate(comparison, kinds)
        terms = past_terms(comparison)
        pending = iter(operands)
        self._readers: dict[str, Callable[[Values], Any]] = {}
        memories: list[_TermMemory] = []
        for each in terms:
            operand = next(pending) if isinstance(each, _OF_FORMULAS) else None
            read, memory = _reader_and_memory(each, operand, kinds)
            self._readers[str(each)] = read
            memories.append(memory)
        atoms = [each for operand in operands for each in operand.atoms]
        super().__init__(atom, atoms, inner, TermMemories(memories))
        self.names.update(map(field_name, fields(comparison)))
        self._terms = [value_field(atom, each) for each in terms]
        self.fields = [self.field, *self._terms]
        self._has_gaps = False

    @property
    def is_plain(self) -> bool:
        """True unless a gap has an effect."""
        return self.gap is None

    def tried(self, memory: TermMemories, time: int, values: Values) -> bool:
        """Let a memory take a state; return the truth of the comparison there.

        Raises:
            ReasoningError: if a value is unusable or unknown.
        """
        return self._holds(self._with_terms(memory, time, values))

    def step(self, time: int, values: MutableMapping[str, Any]) -> None:
        """Take a state, and set the fields of the register."""
        known: Any
        least: Any
        most: Any
        found = self._with_terms(self.memory, time, values)
        try:
            known = least = most = self._holds(found)
        except UnknowableError as error:
            known, least, most = error, False, True
        except ReasoningError as error:
            known = least = most = error
        values[self.field] = known
        if self._has_gaps:
            values.update(zip(self.fields, (known, least, most), strict=False))
            if self.memory.are_known(time) and all(each.gap is None for each in self._inner):
                self.gap = None
        values.update(zip(self._terms, found.maps[0].values(), strict=True))

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""
        if not gap.is_empty:
            self.gap, self._has_gaps = self.gap.join(gap) if self.gap else gap, True
            self.fields = [*(f'{self.field}{each}' for each in BOUNDS), *self._terms]
            self.memory.miss_states(gap)

    def probabilities(self) -> list[ProbabilityInterval]:
        """Return its probabilities at the latest state."""
        memories = (each for each in self.memory.memories if isinstance(each, _ProbabilityMemory))
        return [each.interval for each in memories if each.interval is not None]

    def _with_terms(self, memory: TermMemories, time: int, values: Values) -> ChainMap[str, Any]:
        """Let a memory take a state; return the values of the state and of the past terms."""
        terms: dict[str, Any] = {}
        found = ChainMap(terms, cast('MutableMapping[str, Any]', values))
        for (name, read), each in zip(self._readers.items(), memory.memories, strict=True):
            now: Any
            try:
                now = read(found)
            except NoStateBeforeError:
                now = None
            except ReasoningError as error:
                now = error
            terms[name] = each.step(time, now)
        return found


def value_field(atom: PastAtom, term: PastTerm) -> str:
    """Return the name of the field that holds the value of a past term in a comparison."""
    return f'{atom.field.rstrip("+-")}:{term}'


@dataclass(slots=True)
class TermMemories:
    """The memories of the past terms of a comparison, inner ones first."""

    memories: Sequence[_TermMemory]

    @property
    def key(self) -> Hashable:
        """Equal for memories that will always yield the same values."""
        return tuple(each.key for each in self.memories)

    def of_row(self, _row: int) -> TermMemories:
        """Return a copy."""
        return TermMemories([each.copied() for each in self.memories])

    def miss_states(self, gap: Gap) -> None:
        """Take a gap."""
        for each in self.memories:
            each.miss_states(gap)

    def are_known(self, time: int) -> bool:
        """Return True if no value after a state depends on states that are missing."""
        return all(each.is_known(time) for each in self.memories)


class _TermMemory(ABC):
    """The memory of a past term."""

    @abstractmethod
    def step(self, time: int, now: Any) -> Any:
        """Take the value of the operand at a state, or its error; return the value of the term.

        None stands for an operand or a term without a value.
        """

    @abstractmethod
    def miss_states(self, gap: Gap) -> None:
        """Take a gap."""

    @abstractmethod
    def is_known(self, time: int) -> bool:
        """Return True if no value after a state depends on states that are missing."""

    @property
    @abstractmethod
    def key(self) -> Hashable:
        """Equal for memories that will always yield the same values."""

    def copied(self) -> _TermMemory:
        """Return an independent copy."""
        return copy(self)


class _ValueMemory(_TermMemory):
    """The value of the operand at the latest state."""

    def __init__(self) -> None:
        self._value: Any = None

    def step(self, time: int, now: Any) -> Any:  # noqa: ARG002
        found, self._value = self._value, now
        return found

    def miss_states(self, gap: Gap) -> None:
        self._value = unknowable(gap)

    def is_known(self, time: int) -> bool:  # noqa: ARG002
        return not isinstance(self._value, UnknowableError)

    @property
    def key(self) -> Hashable:
        value = self._value
        return str(value) if isinstance(value, ReasoningError) else (type(value), value)


class _CountMemory(_TermMemory):
    """The times at which the operand held in the window of a count."""

    def __init__(self, term: StateCount) -> None:
        self._term = term
        self._window = cast('int', term.interval.end)
        self._times: deque[int] = deque()
        # The latest state without a usable truth, or the end of a gap.
        self._lost: tuple[ReasoningError, int] | None = None

    def step(self, time: int, now: Any) -> Any:
        times, first = self._times, time - self._window
        if isinstance(now, ReasoningError):
            self._lost = now, time
        elif now:
            times.append(time)
        while times and times[0] < first:
            times.popleft()
        if len(times) > MAX_COUNTED:
            times.clear()
            message = f"'{self._term}' counts more than {MAX_COUNTED} states; use a shorter window"
            self._lost = ReasoningError(message), time
        if self._lost and self._lost[1] >= first:
            return self._lost[0]
        return len(times)

    def miss_states(self, gap: Gap) -> None:
        self._lost = unknowable(gap), gap.before - 1

    def is_known(self, time: int) -> bool:
        is_unknown = self._lost is not None and isinstance(self._lost[0], UnknowableError)
        return not (is_unknown and self._lost and self._lost[1] > time - self._window)

    @property
    def key(self) -> Hashable:
        return tuple(self._times), self._lost and self._lost[1]

    def copied(self) -> _CountMemory:
        found = copy(self)
        found._times = self._times.copy()  # noqa: SLF001 - of the same class
        return found


class _ProbabilityMemory(_TermMemory):
    """The probability of a formula, from the first state on if later states decide it.

    Args:
        term: the probability.
        operands: the operands of its formula, as `right`.
        kinds: the kinds of the features.
    """

    def __init__(self, term: Probability, operands: PastOperands, kinds: Kinds) -> None:
        self._formula = str(term.body)
        self._probability = FormulaProbability(operands.right, operands.atoms, kinds)
        self._error: ReasoningError | None = None
        self.interval: ProbabilityInterval | None = None
        """The probability at the latest state; None if there is none."""

    def step(self, time: int, now: Any) -> Any:
        self.interval = None
        if self._error is not None:
            return self._error
        try:
            asked = self._probability.at_state(time, now)
        except ReasoningError as error:
            if not self._probability.is_of_state:
                self._error = error
            return error
        self.interval = asked.interval()
        return AskedProbability(self.interval, self._formula, is_final=asked.is_final)

    def miss_states(self, gap: Gap) -> None:
        if not (self._probability.is_of_state or self._probability.is_final):
            self._error = self._error or unknowable(gap)

    def is_known(self, time: int) -> bool:  # noqa: ARG002
        return not isinstance(self._error, UnknowableError)

    @property
    def key(self) -> Hashable:
        return self._probability.key, self._error and str(self._error)

    def copied(self) -> _ProbabilityMemory:
        found = copy(self)
        found._probability = self._probability.copied()  # noqa: SLF001 - of the same class
        return found


_OF_FORMULAS: Final = StateCount, Probability
"""The past terms whose operands are formulas."""


def _reader_and_memory(
    term: PastTerm, operands: PastOperands | None, kinds: Kinds
) -> tuple[Callable[[Values], Any], _TermMemory]:
    """Return what reads the operand of a past term, and the memory of the term."""
    if isinstance(term, Probability) and operands:
        return lambda values: values, _ProbabilityMemory(term, operands, kinds)
    if isinstance(term, StateCount) and operands:
        return _truth_reader(operands, kinds), _CountMemory(term)
    return term_reader(term.body, kinds), _ValueMemory()


def past_terms(comparison: Comparison) -> list[PastTerm]:
    """Return the past terms of a comparison, each once, inner ones first."""
    return list(dict.fromkeys(_inner_first(comparison)))


def _inner_first(node: Formula | Term) -> Iterator[PastTerm]:
    if not isinstance(node, _OF_FORMULAS):  # Their operands have atoms of their own.
        for part in parts(node):
            yield from _inner_first(part)
    if isinstance(node, PastTerm):
        yield node


def _truth_reader(operands: PastOperands, kinds: Kinds) -> Callable[[Values], bool]:
    node = operands.right
    read = quick_reader(operands.atoms, kinds, node.mask)
    return lambda values: holds_at(node, read(values))
