"""The ground features that a feature with variables stands for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import product
from math import prod

from dyknow_semantics.annotations.annotation import FeatureTerm, Range
from dyknow_semantics.ontology.knowledge import Knowledge


@dataclass(frozen=True, slots=True)
class Pattern:
    """The ground features that a feature with variables stands for.

    Objects are identified by `Knowledge.identity`.

    Args:
        feature: its shortest name.
        arguments: objects, and variables with the prefix `?`.
        sorts: for each argument, the sort of the variable; empty for an object.
        domains: for each argument, the possible objects.
        names: the arguments with objects by their shortest names as written.
        is_ground: True if all arguments are objects.
        repeats: True if an argument occurs more than once.
    """

    feature: str
    arguments: tuple[str, ...]
    sorts: tuple[str, ...]
    domains: tuple[frozenset[str], ...]
    names: tuple[str, ...]

    is_ground: bool = field(init=False, compare=False)
    repeats: bool = field(init=False, compare=False)

    def __post_init__(self) -> None:
        """Compute what each comparison of patterns needs."""
        object.__setattr__(self, 'is_ground', not any(self.sorts))
        object.__setattr__(self, 'repeats', len(set(self.arguments)) < len(self.arguments))

    def covers(self, objects: tuple[str, ...]) -> bool:
        """Return True if the feature of some objects is one of the ground features."""
        for each, domain in zip(objects, self.domains, strict=True):
            if each not in domain:
                return False
        return not self.repeats or self._is_consistent(objects)

    def common_objects(self, other: Pattern) -> Iterable[tuple[str, ...]]:
        """Return the objects of the ground features that two patterns share."""
        if self.is_ground:
            return (self.arguments,) if other.covers(self.arguments) else ()
        common = [one & another for one, another in zip(self.domains, other.domains, strict=True)]
        return (
            objects
            for objects in product(*common)
            if self._is_consistent(objects) and other._is_consistent(objects)
        )

    def number_in_common(self, other: Pattern) -> int:
        """Return the number of combinations of objects that `common_objects` compares."""
        if self.is_ground:
            return 1
        return prod(len(one & two) for one, two in zip(self.domains, other.domains, strict=True))

    def _is_consistent(self, objects: tuple[str, ...]) -> bool:
        """Return True if each variable has the same object wherever it occurs."""
        binding: dict[str, str] = {}
        return not self.repeats or all(
            binding.setdefault(argument, each) == each
            for argument, each in zip(self.arguments, objects, strict=True)
        )


def pattern_of(
    term: FeatureTerm,
    ranges: Iterable[Range],
    knowledge: Knowledge,
    identities: Callable[[str], frozenset[str]],
) -> Pattern:
    """Return the pattern of a checked term; a term without arguments stands for all objects.

    `ranges` has the variables of the term; `identities` returns the objects of a sort.

    Raises:
        SemanticsError: if a name is unknown.
    """
    feature = knowledge.feature(term.name)
    sort_of = {each.variable: each.sort for each in ranges}
    written = [argument.name for argument in term.arguments]
    if not written:
        # A variable for each argument, named by its index.
        written = [str(index) for index, _ in enumerate(feature.argument_sorts)]
        sort_of = dict(zip(written, feature.argument_sorts, strict=True))
    names = tuple(f'?{name}' if name in sort_of else knowledge.instance(name) for name in written)
    arguments = tuple(map(knowledge.identity, names))
    sorts = tuple(sort_of.get(name, '') for name in written)
    domains = tuple(
        identities(sort) if sort else frozenset((argument,))
        for sort, argument in zip(sorts, arguments, strict=True)
    )
    return Pattern(feature.name, arguments, sorts, domains, names)
