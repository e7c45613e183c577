"""The fast path: generated code for states at which each instance needs one table look-up only.

Most states of most streams are such. One function reads each field once for all instances, checks
its type, and moves each instance to the next row of its table. If that is impossible, the function
has no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.configurations import Row
from dyknow_reasoning.execution.automata.readers import MAX_GENERATED, Reader, ReaderCode
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.progression.atoms import Values

_MAX_INSTANCES = 256
_MAX_ATOMS = 2048
"""The most atoms of all instances: code for many takes long to compile."""
_MIN_STATES = 4
"""States without more than look-ups before code is generated."""

Step: TypeAlias = Callable[[int, Values], bool]


class FastPath:
    """Progresses instances by generated code, between `enter` and `leave`.

    `step(valid_time, values)` progresses all instances over a state. It returns False, and has no
    effect, if the state needs more than look-ups. It is None if the fast path is not entered.
    """

    def __init__(self) -> None:
        self.step: Step | None = None
        self._instances: Sequence[SingleInstance] = ()
        self._elapsed = 0
        self._readers: list[Reader] = []
        self._generated_step: Step
        self._enter: Callable[..., None]
        self._position: Callable[[], tuple[int, Sequence[Row]]]
        self._states = 0

    def enter(self, instances: Sequence[SingleInstance], elapsed: int, latest: int) -> None:
        """Enter the fast path if it is worthwhile.

        Args:
            instances: the instances, each at a configuration.
            elapsed: the step of time for which the fast path works, in nanoseconds.
            latest: the valid time of the latest state.
        """
        self._states += 1
        is_same = instances is self._instances and elapsed == self._elapsed
        if not (is_same and self._readers == [each.read for each in instances]):
            if self._states < _MIN_STATES or len(instances) > _MAX_INSTANCES:
                return
            atoms = [each.mask.bit_count() for each in instances]
            if max(atoms) > MAX_GENERATED or sum(atoms) > _MAX_ATOMS:
                return
            self._generate(instances, elapsed)
        configurations = (each.configuration for each in instances)
        self._enter(latest, *(found.row(elapsed) for found in configurations if found))
        self.step = self._generated_step

    def leave(self) -> int | None:
        """Leave the fast path; return the valid time of the latest state, None if not entered."""
        if self.step is None:
            return None
        self.step = None
        latest, rows = self._position()
        for instance, row in zip(self._instances, rows, strict=True):
            instance.configuration = row.configuration
        return latest

    def _generate(self, instances: Sequence[SingleInstance], elapsed: int) -> None:
        self._states = 0
        self._instances, self._elapsed = instances, elapsed
        self._readers = [each.read for each in instances]
        self._generated_step, self._enter, self._position = _functions(instances, elapsed)


def _functions(instances: Sequence[SingleInstance], elapsed: int) -> Any:
    """Return the functions `step`, `enter` and `position`, which share the rows of instances."""
    source = ReaderCode()
    source.names['ReasoningError'] = ReasoningError
    symbols = [
        source.symbol(each.instance.atoms, each.instance.kinds, each.predicates)
        for each in instances
    ]
    rows = [f'row_{index}' for index in range(len(instances))]
    next_rows = [f'next_{index}' for index in range(len(instances))]
    moves = '; '.join(
        f'{after} = {row}[{symbol}]'
        for after, row, symbol in zip(next_rows, rows, symbols, strict=True)
    )
    changes = '; '.join(f'{row} = {after}' for row, after in zip(rows, next_rows, strict=True))
    return source.run(
        f"""
def make():
    latest = {' = '.join(rows)} = None
    def enter(time, {', '.join(next_rows)}):
        nonlocal latest, {', '.join(rows)}
        latest = time
        {changes}
    def position():
        return latest, ({', '.join(rows)},)
    def step(time, values):
        nonlocal latest, {', '.join(rows)}
        if time - latest != {source.name(elapsed)}: return False
        try:
            {source.reads}
            if {source.unusual}: return False
            {moves}
        except (KeyError, ReasoningError): return False
        latest = time
        {changes}
        return True
    return step, enter, position
"""
    )
