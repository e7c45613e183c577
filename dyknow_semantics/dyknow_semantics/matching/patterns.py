"""The ground features that a feature with variables stands for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import product

from dyknow_semantics.annotations.annotation import FeatureTerm, Range
from dyknow_semantics.ontology.knowledge import Knowledge


@dataclass(frozen=True, slots=True)
class Pattern:
    """The ground features that a feature with variables stands for.

    Objects are told apart by `Knowledge.identity`.

    Args:
        feature: its shortest name.
        arguments: objects, and variables, marked by `?`.
        sorts: what the variable at each place ranges over; empty for an object.
        domains: the objects that may stand at each place.
        words: the arguments by the names that were written for them, each the shortest.
        is_ground: whether all arguments are objects.
        repeats: whether an argument stands at several places.
    """

    feature: str
    arguments: tuple[str, ...]
    sorts: tuple[str, ...]
    domains: tuple[frozenset[str], ...]
    words: tuple[str, ...]

    is_ground: bool = field(init=False, compare=False)
    repeats: bool = field(init=False, compare=False)

    def __post_init__(self) -> None:
        """Settles what is asked of every pattern, over and over."""
        object.__setattr__(self, 'is_ground', not any(self.sorts))
        object.__setattr__(self, 'repeats', len(set(self.arguments)) < len(self.arguments))

    def covers(self, objects: tuple[str, ...]) -> bool:
        """Whether the feature of some objects is one of the ground features."""
        for each, domain in zip(objects, self.domains, strict=True):
            if each not in domain:
                return False
        return not self.repeats or self._is_one_each(objects)

    def common_objects(self, other: Pattern) -> Iterable[tuple[str, ...]]:
        """The objects of the ground features that two features with variables both stand for."""
        if self.is_ground:
            return (self.arguments,) if other.covers(self.arguments) else ()
        common = [one & another for one, another in zip(self.domains, other.domains, strict=True)]
        return (
            objects
            for objects in product(*common)
            if self._is_one_each(objects) and other._is_one_each(objects)
        )

    def _is_one_each(self, objects: tuple[str, ...]) -> bool:
        """Whether each variable stands for the same object wherever it stands."""
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
    """The ground features of a term that has been checked; without arguments, those of all objects.

    Args:
        term: a feature with its arguments.
        ranges: its variables.
        knowledge: what the ontologies say, with the bridges between them.
        identities: the objects of a sort.

    Raises:
        SemanticsError: if the ontology does not know a name.
    """
    feature = knowledge.feature(term.name)
    sorts = {each.variable: each.sort for each in ranges}
    names = [argument.name for argument in term.arguments]
    if not names:
        # A variable for each place: all that the feature can take.
        names = [str(place) for place, _ in enumerate(feature.argument_sorts)]
        sorts = dict(zip(names, feature.argument_sorts, strict=True))
    words = tuple(f'?{name}' if name in sorts else knowledge.instance(name) for name in names)
    arguments = tuple(map(knowledge.identity, words))
    placed = tuple(sorts.get(name, '') for name in names)
    domains = tuple(
        identities(sort) if sort else frozenset((argument,))
        for sort, argument in zip(placed, arguments, strict=True)
    )
    return Pattern(feature.name, arguments, placed, domains, words)
