"""States over which nothing happens but a look-up for each instance, by generated code.

Most states of most streams are such. One function reads each field once for all instances, tests
it, and goes to the next row for each. Where that will not do, it has done nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.configurations import Row
from dyknow_reasoning.execution.automata.readers import ReaderCode
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.progression.atoms import Values


class FastPath:
    """Progresses instances by look-ups.

    Args:
        singles: the instances.
        elapsed: the step of time for which it works, in nanoseconds.
    """

    def __init__(self, singles: Sequence[SingleInstance], elapsed: int) -> None:
        self.elapsed = elapsed
        self.step: Callable[[Values], bool]
        self._singles = singles
        self._readers = [single.read for single in singles]
        self._enter: Callable[..., None]
        self._rows: Callable[[], Sequence[Row]]
        self.step, self._enter, self._rows = _functions(singles)

    def suits(self, singles: Sequence[SingleInstance]) -> bool:
        """Whether these are the instances, and read the same atoms as before."""
        return singles is self._singles and self._readers == [each.read for each in singles]

    def enter(self) -> None:
        """Takes where the instances are."""
        configurations = (each.configuration for each in self._singles)
        self._enter(*(found.row(self.elapsed) for found in configurations if found))

    def leave(self) -> None:
        """Tells the instances where they are."""
        for single, row in zip(self._singles, self._rows(), strict=True):
            single.configuration = row.configuration


def _functions(singles: Sequence[SingleInstance]) -> Any:
    """The functions `step`, `enter` and `rows`, which share a row for each instance."""
    source = ReaderCode()
    source.names['ReasoningError'] = ReasoningError
    members = [single.member for single in singles]
    symbols = [
        source.symbol(member.instance.atoms, member.kinds, single.active)
        for member, single in zip(members, singles, strict=True)
    ]
    rows = [f'row_{index}' for index in range(len(singles))]
    afters = [f'after_{index}' for index in range(len(singles))]
    moves = '; '.join(
        f'{after} = {row}[{symbol}]'
        for after, row, symbol in zip(afters, rows, symbols, strict=True)
    )
    changes = '; '.join(f'{row} = {after}' for row, after in zip(rows, afters, strict=True))
    return source.compiled(
        f"""
def made():
    {' = '.join(rows)} = None
    def enter({', '.join(afters)}):
        nonlocal {', '.join(rows)}
        {changes}
    def rows():
        return ({', '.join(rows)},)
    def step(values):
        nonlocal {', '.join(rows)}
        try:
            {source.reads}
            if {source.unusual}: return False
            {moves}
        except (KeyError, ReasoningError): return False
        {changes}
        return True
    return step, enter, rows
"""
    )
