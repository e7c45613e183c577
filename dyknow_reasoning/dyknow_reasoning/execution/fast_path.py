"""The fast path, for states at which each instance needs one table look-up only.

Most states of most streams are such. One function of generated code reads each field once for all
instances, checks its type, and moves each instance to the next row of its table. If look-ups do not
suffice, it has no effect. Batches, which are vectors already, have no such path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.configurations import Row
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.execution.automata.readers import MAX_GENERATED, Reader, ReaderCode
from dyknow_reasoning.execution.instance_pool import InstancePool
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.progression.atoms import Predicate, Values

_MAX_INSTANCES = 256
_MAX_ATOMS = 2048
"""The most atoms of all instances: code for many takes long to compile."""
_MIN_STATES = 4
"""States without more than look-ups before code is generated."""

Step: TypeAlias = Callable[[int, Values], bool]


@dataclass(frozen=True, slots=True)
class LookUps:
    """Generated code, which has the latest row of each instance.

    Args:
        step: progresses all instances over a state, `step(valid_time, values)`. It returns False,
            and has no effect, if that needs more than look-ups.
        enter: sets the time of the latest state, the step of time between states, and the rows,
            `enter(latest, elapsed, *rows)`; times are in nanoseconds.
        position: returns the time of the latest state, and the rows.
    """

    step: Step
    enter: Callable[..., None]
    position: Callable[[], tuple[int, Sequence[Row]]]


_CODE: Final = """
def make():
    latest = elapsed = {no_rows} = None
    def enter(time, step_of_time, {next_rows}):
        nonlocal latest, elapsed, {rows}
        latest, elapsed = time, step_of_time
        {changes}
    def position():
        return latest, ({rows},)
    def step(time, values):
        nonlocal latest, {rows}
        if time - latest != elapsed: return False
        try:
            {reads}
            if {unusual}: return False
            {moves}
        except (KeyError, ReasoningError): return False
        latest = time
        {changes}
        return True
    return step, enter, position
"""


class FastPath:
    """Progresses instances by generated code, between `enter` and `leave`."""

    def __init__(self) -> None:
        self._is_entered = False
        self._instances: Sequence[SingleInstance] = ()
        self._readers: list[Reader] = []
        self._look_ups: LookUps
        self._states = 0

    def enter(self, pool: InstancePool, elapsed: int, latest: int) -> Step | None:
        """Enter the fast path if it is worthwhile, and return the `step` of `LookUps`.

        Args:
            pool: the instances, each at a configuration.
            elapsed: the step of time for which the fast path works, in nanoseconds.
            latest: the valid time of the latest state.
        """
        self._states += 1
        instances = pool.singles
        is_same = instances is self._instances
        if not (is_same and self._readers == [each.read for each in instances]):
            if self._states < _MIN_STATES:
                return None
            look_ups = look_ups_of([(each.instance, each.predicates) for each in instances])
            if look_ups is None:
                return None
            self._states = 0
            self._look_ups, self._instances = look_ups, instances
            self._readers = [each.read for each in instances]
        configurations = (each.configuration for each in instances)
        rows = (found.row(elapsed) for found in configurations if found)
        self._look_ups.enter(latest, elapsed, *rows)
        self._is_entered = True
        return self._look_ups.step

    def leave(self) -> int | None:
        """Leave the fast path; return the valid time of the latest state, None if not entered."""
        if not self._is_entered:
            return None
        self._is_entered = False
        latest, rows = self._look_ups.position()
        for instance, row in zip(self._instances, rows, strict=True):
            instance.configuration = row.configuration
        return latest


def look_ups_of(
    instances: Sequence[tuple[FormulaInstance, Mapping[int, Predicate]]],
) -> LookUps | None:
    """Return the code for some instances; None if it would be too large.

    Args:
        instances: each with the predicates of the atoms that it depends on, by their slots.
    """
    atoms = [len(predicates) for _, predicates in instances]
    if len(instances) > _MAX_INSTANCES or sum(atoms) > _MAX_ATOMS or max(atoms) > MAX_GENERATED:
        return None
    source = ReaderCode()
    source.names['ReasoningError'] = ReasoningError
    symbols = [
        source.symbol(instance.atoms, instance.kinds, predicates)
        for instance, predicates in instances
    ]
    rows = [f'row_{index}' for index in range(len(instances))]
    next_rows = [f'next_{index}' for index in range(len(instances))]
    moves = '; '.join(
        f'{after} = {row}[{symbol}]'
        for after, row, symbol in zip(next_rows, rows, symbols, strict=True)
    )
    changes = '; '.join(f'{row} = {after}' for row, after in zip(rows, next_rows, strict=True))
    code = _CODE.format(
        rows=', '.join(rows),
        next_rows=', '.join(next_rows),
        no_rows=' = '.join(rows),
        changes=changes,
        moves=moves,
        reads=source.reads,
        unusual=source.unusual,
    )
    return LookUps(*source.run(code))
