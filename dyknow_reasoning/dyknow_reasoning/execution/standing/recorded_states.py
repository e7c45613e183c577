"""Progression of a formula that is asked at every state over the states of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.execution.recorded_symbols import RecordedSymbols
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.standing.standing_monitor import StandingMonitor

_MAX_SYMBOLS = 1 << 18
"""The most symbols that are evaluated together."""


def progress_recording(
    monitor: StandingMonitor, recording: Recording
) -> tuple[bool, tuple[int, ReasoningError] | None]:
    """Progress over a recording, with the same results as `progress` for each state.

    Returns:
        True if a failure has begun or ended, and the index of the state at which the formula can no
        longer be progressed, with the error.
    """
    changed, index = False, 0
    times: list[int] = recording.times.tolist()
    try:
        while index < len(times):
            symbols = _symbols(monitor.instances, recording, index)
            for each in symbols:
                changed |= monitor.take(each, times[index], partial(recording.values, index))
                index += 1
            if not symbols:
                changed |= monitor.progress(times[index], recording.values(index))
                index += 1
    except ReasoningError as error:
        return changed, (index, error)
    return changed, None


def _symbols(
    instances: Sequence[FormulaInstance], recording: Recording, first: int
) -> Sequence[tuple[int, ...]]:
    """Return the truth of the atoms of each instance at states from an index on.

    There are none if a value of the first of these states is unusable.
    """
    size = 1 + _MAX_SYMBOLS // (1 + len(instances))
    found = RecordedSymbols(recording, range(first, min(first + size, len(recording))))
    if not instances:
        return [()] * len(found.states)
    sequences = [found.of_atoms(each.atoms, each.node.mask, each.kinds) for each in instances]
    lists = [each.symbols[: len(found.states)].tolist() for each in sequences]
    return list(zip(*lists, strict=True))
