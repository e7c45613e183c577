"""Comparisons of objects that have several names."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from dyknow_coordinator import CoordinationError, check_compared_objects

DOMAINS = {
    'UAV': ('uav:scout', 'robot2:scout', 'uav1', 'uav2'),
    'Drone': ('robot2:scout', 'self'),
    'Rover': ('rover1',),
}
SAME = [('self', 'robot3:kopter'), ('uav2', 'robot3:kopter'), ('rover1', 'truck')]


async def _synonyms(_: str) -> Sequence[tuple[str, ...]]:
    return SAME


def check(formula: str) -> str:
    """Return why a formula is refused; empty if it is not."""
    coroutine = check_compared_objects(formula, DOMAINS, _synonyms)
    try:
        coroutine.send(None)
    except StopIteration:
        return ''
    except CoordinationError as error:
        return str(error)
    raise AssertionError


@pytest.mark.parametrize(
    'formula',
    [
        'forall u in UAV: (forall v in UAV: ((u != v) -> (always (Distance[u, v] > 5))))',
        'forall u in UAV: ((u != uav1) -> (always (Altitude[u] < 30)))',
        'forall u in UAV: (exists r in Rover: (u = r))',
        'forall d in Drone: ((d = self) -> (always (height[d] < 30)))',
        # No objects are compared.
        'forall u in UAV: (forall d in Drone: (always (Altitude[u] = height[d])))',
        'forall u in UAV: (always (mode != "u != self"))',
        'always (self = uav2)',
        'forall u in UAV: (let self = Mode[u] in (eventually (Mode[u] != self)))',
        # A variable has the name of several objects, another one has two sorts.
        'forall scout in UAV: (scout != uav1)',
        '(exists u in UAV: (u = uav1)) and (exists u in Drone: (u = self))',
    ],
)
def test_objects_with_one_name_each(formula: str) -> None:
    assert check(formula) == ''


@pytest.mark.parametrize(
    ('formula', 'reason'),
    [
        (
            'forall u in UAV: (forall d in Drone: ((u != d) -> (Distance[u, d] > 5)))',
            "'u != d' compares names, but 'self' and 'uav2' are one object",
        ),
        (
            'forall u in UAV: ((u = self) -> (always (Altitude[u] < 30)))',
            "'u = self' compares names, but 'self' and 'uav2' are one object",
        ),
        (
            'at most 1 r in Rover: (truck != r)',
            "'truck != r' compares names, but 'rover1' and 'truck' are one object",
        ),
        (
            'count(truck = r for r in Rover) < 2',
            "'truck = r' compares names, but 'rover1' and 'truck' are one object",
        ),
        (
            'over (a != self for a, b in UAV) from uav1 to s: (somewhere[0, 2 hops] (X[s] > 1))',
            "'a != self' compares names, but 'self' and 'uav2' are one object",
        ),
        (
            'over (X[a] < 3 for a, b in UAV) from uav1 to s: (somewhere[0, inf) (s != self))',
            "'s != self' compares names, but 'self' and 'uav2' are one object",
        ),
        (
            '(exists r in UAV: (X[r] > 1)) and (forall r in Rover: (r = truck))',
            "'r = truck' compares names, but 'rover1' and 'truck' are one object",
        ),
        (
            'forall u in UAV: ((Distance[u, uav2] > 3) or (self = uav2))',
            "'self = uav2' compares names, but 'self' and 'uav2' are one object",
        ),
        (
            'exists u in UAV: ((scout = u) and (always (Altitude[u] < 30)))',
            "'scout = u' is ambiguous: there are robot2:scout, uav:scout",
        ),
    ],
)
def test_a_comparison_of_two_names_of_one_object(formula: str, reason: str) -> None:
    assert reason in check(formula)
