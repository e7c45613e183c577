"""Who is progressed by itself, and who together with others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence

from dyknow_reasoning.execution.automata.templates import InstanceState
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.batch import Batch

_FEWEST_IN_A_BATCH = 24


def assign_batches(
    seats: Iterable[InstanceState],
    singles: Sequence[SingleInstance],
    batches: Sequence[Batch],
    latest: int,
) -> tuple[list[SingleInstance], list[Batch]]:
    """Adds instances to others: those of one shape whose atoms are alike make a batch, if many.

    Args:
        seats: the instances to add.
        singles: those that are progressed by themselves.
        batches: those that are progressed together.
        latest: the valid time of the latest state.
    """
    alike: defaultdict[Hashable, list[InstanceState]] = defaultdict(list)
    for seat in seats:
        alike[seat.member.kin].append(seat)
    alone: defaultdict[Hashable, list[SingleInstance]] = defaultdict(list)
    for single in singles:
        alone[single.member.kin].append(single)
    together = {batch.kin: batch for batch in batches}
    for kin, found in alike.items():
        batch = together.get(kin)
        if batch:
            together[kin] = Batch([*batch.seats(latest), *found])
        elif isinstance(kin, tuple) and len(found) + len(alone[kin]) >= _FEWEST_IN_A_BATCH:
            others = (single.seat(latest) for single in alone.pop(kin))
            together[kin] = Batch([*others, *found])
        else:
            alone[kin] += map(SingleInstance, found)
    return [single for found in alone.values() for single in found], list(together.values())
