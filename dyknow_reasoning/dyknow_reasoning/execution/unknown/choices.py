"""All runs of a function that chooses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

_Result = TypeVar('_Result')


class Choices:
    """The choices of one run, in their order.

    Args:
        first: the number of the option that each of the first choices takes; later ones take the
            first option.
    """

    def __init__(self, first: tuple[int, ...] = ()) -> None:
        self._taken = list(first)
        self._next = 0
        self.others: list[tuple[int, ...]] = []
        """The first choices of the runs that differ from this one in a later choice first."""

    def choose(self, options: Sequence[Any]) -> Any:
        """Return one of some options."""
        if self._next == len(self._taken):
            taken = tuple(self._taken)
            self.others += [(*taken, number) for number in range(1, len(options))]
            self._taken.append(0)
        found = options[self._taken[self._next]]
        self._next += 1
        return found


def all_runs(function: Callable[[Choices], _Result]) -> Iterator[_Result]:
    """Yield the results of a function for all that it can choose."""
    pending: list[tuple[int, ...]] = [()]
    while pending:
        choices = Choices(pending.pop())
        yield function(choices)
        pending += choices.others
