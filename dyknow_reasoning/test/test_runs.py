"""Runs of states, compared with sets of their numbers."""

from __future__ import annotations

from random import Random

from dyknow_reasoning.execution.standing.runs import Run, StateTimes, split, union

CASES = 5000


def runs_of(numbers: set[int]) -> list[Run]:
    found: list[Run] = []
    for each in sorted(numbers):
        if found and found[-1].last + 1 == each:
            found[-1] = Run(found[-1].first, each, found[-1].begin, 10 * each)
        else:
            found.append(Run(each, each, 10 * each, 10 * each))
    return found


def test_unions_are_those_of_sets() -> None:
    random = Random(1)  # noqa: S311 - no secret
    kinds = set()
    for _ in range(CASES):
        first = set(random.sample(range(12), random.randint(0, 5)))
        second = set(random.sample(range(random.choice([0, 6]), 12), random.randint(0, 5)))
        before = runs_of(first), runs_of(second)
        found = union(*before)
        assert found == runs_of(first | second)
        assert before == (runs_of(first), runs_of(second))
        if first and second:
            low, high = sorted([first, second], key=max)
            kinds.add(min(2, max(-1, min(high) - max(low))))
    assert kinds == {-1, 0, 1, 2}


def test_splits_are_those_of_times() -> None:
    random = Random(2)  # noqa: S311 - no secret
    times = StateTimes()
    for each in range(0, 130, 10):
        times.append(each)
    for _ in range(CASES):
        numbers = set(random.sample(range(12), random.randint(0, 7)))
        time = random.randint(-5, 125)
        before = runs_of(numbers)
        older, younger = split(before, time, times)
        assert older == runs_of({each for each in numbers if 10 * each < time})
        assert younger == runs_of({each for each in numbers if 10 * each >= time})
        assert before == runs_of(numbers)
