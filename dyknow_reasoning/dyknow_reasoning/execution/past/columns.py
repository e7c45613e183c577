"""Past operators over many states at once, with numpy.

`since[a, b]` holds at state i if there is a candidate j in a range of states: those that are valid
in [ti - b, ti - a], and not before the last state k < i at which the left side did not hold. The
range is found by searching the times, and the candidates in it are counted by their running sum.
Candidates of earlier states are put before the recording as states of their own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dyknow_reasoning.execution.past.machines import Machine, PreviousMachine, SinceMachine
from dyknow_reasoning.execution.vectors.atom_vectors import Array
from dyknow_reasoning.progression.nodes import AtLeast, Constant, Junction, Literal, Node

_MAX_TIME = 1 << 60


def node_truths(node: Node, truth_of: Callable[[int], Array], count: int) -> Array:
    """Return the truth of a formula without windows, for many states or objects.

    Args:
        node: the formula.
        truth_of: returns the truth of the atom of a slot.
        count: the number of states or objects.
    """
    match node:
        case Literal(slot=slot, positive=positive):
            truths = truth_of(slot)
            return truths if positive else ~truths
        case Junction(universal=universal, parts=parts):
            combine = np.logical_and if universal else np.logical_or
            found: Array = combine.reduce([node_truths(part, truth_of, count) for part in parts])
            return found
        case AtLeast(count=least, parts=parts):
            counts: Array = np.sum([node_truths(part, truth_of, count) for part in parts], axis=0)
            return counts >= least
        case Constant(value=value):
            return np.full(count, value)
        case _:  # pragma: no cover - operands have no windows
            raise AssertionError(node)


def step_many(machine: Machine, times: Array, left: Array, right: Array) -> Array:
    """Return the truth of an operator at many states, as `step` does for each."""
    if isinstance(machine, PreviousMachine):
        found = np.concatenate(([machine.value], right[:-1]))
        for index in range(max(0, len(times) - 2), len(times)):
            machine.step(int(times[index]), True, bool(right[index]))
        return found
    return _since_many(machine, times, left, right)


def _since_many(machine: SinceMachine, times: Array, left: Array, right: Array) -> Array:
    start, end = machine.start, machine.end
    carried = [last for _, last in machine.younger]
    if machine.latest is not None:
        # Without an end, any time that is long enough ago.
        oldest = min([int(times[0]), *carried]) - start - 1
        carried.insert(0, oldest if end is None else machine.latest)
    limits = (start, end or 0, *map(abs, carried))
    kind = object if max(limits) > _MAX_TIME or times.dtype == object else times.dtype
    first = len(carried)
    times = np.concatenate((np.array(carried, kind), times.astype(kind)))
    left = np.concatenate((np.ones(first, bool), left))
    right = np.concatenate((np.ones(first, bool), right))
    indices = np.arange(len(times))
    # The last state until each at which the left side did not hold; candidates from it on count.
    breaks = np.maximum.accumulate(np.where(left, 0, indices))
    oldest_valid = np.concatenate(([0], breaks[:-1]))
    begins = oldest_valid
    if end is not None:
        begins = np.maximum(begins, np.searchsorted(times, times - end, 'left'))
    ends = np.searchsorted(times, times - start, 'right') if start else indices + 1
    counts = np.concatenate(([0], np.cumsum(right)))
    found: Array = (ends > begins) & (counts[ends] > counts[np.minimum(begins, ends)])
    candidates = np.flatnonzero(right[breaks[-1] :]) + breaks[-1]
    _remember(machine, times, candidates)
    return found[first:]


def _remember(machine: SinceMachine, times: Array, candidates: Array) -> None:
    """Set the candidates of a machine, of which only those that matter after the states."""
    start, end, now = machine.start, machine.end, int(times[-1])
    machine.clear()
    if end is None or start == 0:
        kept = candidates[:1] if end is None else candidates[-1:]
    else:
        kept = candidates[times[candidates] >= now - end]
    for time in times[kept].tolist():
        machine.add(int(time), int(time))
    machine.mature(now)
