"""Probabilities of the atoms of a formula at one state.

An atom compares a sum of uncertain numbers with a certain number. Given the certain values of the
state, the atom is `c1*q1 + ... + cn*qn + rest < 0`, where the qi are normally distributed. Atoms
that share a number depend on each other, such as `x > 1` and `x > 2`. They are a *component*. If
all atoms of a component compare one sum, their thresholds divide the values of the sum into
*cells*. Within a cell, the truth of all atoms is constant:

    x is normal(1.5, 1)      x <= 1    1 < x <= 2    2 < x
    x > 1, x > 2             no, no    yes, no       yes, yes
    probability              0.31      0.38          0.31

Bounds where nothing is known about dependence: `at_least` (Frechet; Rueger 1978 for counts), and
for the sum of n numbers, P(sum <= 0) is at least 1 - n * Phi(-z) and at most n * Phi(z) with
z = -(sum of means) / (sum of deviations): the sum is negative if each number is at most its mean
plus z deviations, and only if at least one number is.

Numbers with covariances are normally distributed together, so a sum of them is, too, with a known
deviation. Each such *group* counts as one number in the bounds above.

A number with a bounded error may be anywhere within its bounds, whatever the other numbers are. If
only this number is compared with thresholds, each order of it among the thresholds is tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from math import erfc, hypot, inf, isfinite, prod, sqrt
from typing import Any, Final, TypeAlias

from dyknow_common import COMPARISONS, MIRRORED_COMPARISONS
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.probability.distances import TOLERANCE, DistanceAtom, distance_of
from dyknow_reasoning.execution.probability.sums import Sum, sum_of
from dyknow_reasoning.language.formula import Atom, Comparison, walk
from dyknow_reasoning.language.terms import Bounded, Uncertain
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, predicate, term_reader
from dyknow_reasoning.progression.nodes import (
    AtLeast,
    Constant,
    Junction,
    Literal,
    Node,
    holds_at,
    slots,
)

Chance: TypeAlias = tuple[float, float]
"""The least and the greatest probability that is possible."""

Moments: TypeAlias = Sequence[tuple[float, float]]
"""The mean and the deviation of each uncertain number at a state."""

Cells: TypeAlias = Sequence[tuple[int, float]]
"""The probability of each combination of truths of some atoms, given as bits."""

_LESS: Final = {'<', '<='}
_GREATER: Final = {'>', '>='}

MAX_CELLS: Final = 4096
"""The most truths of the atoms of a formula that one state may give."""


def complement(chance: Chance) -> Chance:
    """Return the probability that something does not hold."""
    return 1.0 - chance[1], 1.0 - chance[0]


def at_least(count: int, chances: Iterable[Chance]) -> Chance:
    """Return the probability that at least a number of events occur, whatever their dependence."""
    known = list(chances)
    rest = len(known) - count + 1
    least = 1.0 - _most(rest, [1.0 - lower for lower, _ in known])
    return max(0.0, least), _most(count, [upper for _, upper in known])


def _most(count: int, chances: list[float]) -> float:
    """Return the greatest probability that at least a number of events occur.

    If so, then without the m most likely ones at least count - m of the others occur (Markov).
    """
    if count <= 0:
        return 1.0
    chances.sort()
    found, total = 1.0, sum(chances)
    for most_likely in range(min(count, len(chances))):
        found = min(found, total / (count - most_likely))
        total -= chances[-1 - most_likely]
    return found if count <= len(chances) else 0.0


def _below(deviations: float) -> float:
    """Return the probability that a standard normal number is less than a value (Phi)."""
    return 0.5 * erfc(-deviations / sqrt(2))


def _between(first: float, last: float) -> float:
    """Return the probability that it is between two values, precisely also in the tails."""
    if first > 0:
        return _below(-first) - _below(-last)
    return _below(last) - _below(first)


class _UncertainAtom:
    """A comparison of a sum with zero.

    Args:
        atom: the comparison.
        difference: its left side minus its right side.
        order: the index of each uncertain number.
    """

    def __init__(self, atom: Comparison, difference: Sum, order: Sequence[Uncertain]) -> None:
        factors = sorted((order.index(each), f) for each, f in difference.factors.items())
        self._scale = factors[0][1]
        # Atoms with equal directions compare one sum.
        self.direction = tuple((index, factor / self._scale) for index, factor in factors)
        # The directions of the sum in each group of numbers.
        self.directions: list[tuple[tuple[int, float], ...]] = [(each,) for each in self.direction]
        is_turned = self._scale < 0
        self.operator = MIRRORED_COMPARISONS[atom.operator] if is_turned else atom.operator
        self._atom, self._difference = atom, difference

    def group(self, groups: Sequence[int]) -> None:
        """Let the numbers of a group count as one, given the group of each number."""
        found: dict[int, tuple[tuple[int, float], ...]] = {}
        for number, factor in self.direction:
            found[groups[number]] = (*found.get(groups[number], ()), (number, factor))
        self.directions = list(found.values())

    def threshold(self, values: Values) -> float:
        """Return the number that the sum of the direction is compared with.

        Raises:
            ReasoningError: if it is not a number.
        """
        return -_rest(self._atom, self._difference, values) / self._scale


@dataclass(frozen=True, slots=True)
class _Component:
    """Atoms that share uncertain numbers, or groups of these.

    Args:
        atoms: the atoms by their slots.
        has_one_group: True if all their numbers are in one group.
    """

    atoms: Mapping[int, _UncertainAtom]
    has_one_group: bool

    @property
    def has_one_sum(self) -> bool:
        """True if all atoms compare one sum."""
        return len({each.direction for each in self.atoms.values()}) == 1

    @property
    def direction(self) -> Sequence[tuple[int, float]]:
        """The sum, if it is one."""
        return next(iter(self.atoms.values())).direction

    def thresholds(self, values: Values) -> dict[int, float]:
        """Return the number that each atom compares the sum with."""
        return {slot: each.threshold(values) for slot, each in self.atoms.items()}

    def bits_at(self, value: float, thresholds: Mapping[int, float]) -> int:
        """Return the truths of the atoms for a value of the sum."""
        compared = (
            COMPARISONS[each.operator](value, thresholds[slot]) << slot
            for slot, each in self.atoms.items()
        )
        return sum(compared)

    @property
    def is_known(self) -> bool:
        """True if its distribution is known, whatever the dependence of other numbers."""
        return self.has_one_group and self.has_one_sum


class StateDistribution:
    """The joint distribution of the atoms of a formula at a state.

    Args:
        atoms: the atom of each slot.
        kinds: the kinds of the features.
        mask: the slots of the formula, as bits.

    Attributes:
        numbers: the uncertain numbers; `moments` are in their order.
        is_independent: True if their errors are independent of each other.
        is_bounded: True if all errors are bounded.
        is_joint: True if their errors at one state have a known joint distribution, whatever their
            time constants are.
        is_linear: True if each atom compares a sum of uncertain numbers.
        has_bounds: True if each atom compares a sum, or a distance with a known joint distribution.
        has_covariances: True if covariances of numbers are given.
        has_cells: True if `cells` are defined.
    """

    def __init__(self, atoms: Sequence[Atom], kinds: Kinds, mask: int) -> None:
        self._certain: dict[int, Callable[[Values], bool]] = {}
        self._uncertain: dict[int, _UncertainAtom] = {}
        self._distances: dict[int, DistanceAtom] = {}
        self.is_linear = self.has_bounds = True
        self.numbers: list[Uncertain] = []
        self._readers: list[tuple[Callable[[Values], Any], Callable[[Values], Any]]] = []
        for slot in slots(mask):
            self._add(slot, atoms[slot], kinds)
        self.is_independent = all(each.time_constant is not None for each in self.numbers)
        self.is_bounded = all(isinstance(each, Bounded) for each in self.numbers)
        self._covariances = _covariances(self.numbers, kinds)
        self.has_covariances = bool(self._covariances)
        self._groups = _groups(self.numbers, self._covariances)
        for each in self._uncertain.values() if self._covariances else ():
            each.group(self._groups)
        self.has_bounds &= all(map(self._is_known, self._distances.values()))
        self.is_joint = len(set(self._groups)) == 1 and not self.is_bounded
        self._components: dict[int, list[_Component]] = {}
        all_have_one_sum = all(each.has_one_sum for each in self._components_of(mask))
        self.has_cells = self.is_linear and all_have_one_sum

    def _add(self, slot: int, atom: Atom, kinds: Kinds) -> None:
        found = [each for each in walk(atom) if isinstance(each, Uncertain)]
        for each in found:
            if each not in self.numbers:
                self.numbers.append(each)
                read_mean, read_deviation = (
                    term_reader(term, kinds) for term in (each.mean, each.deviation)
                )
                self._readers.append((read_mean, read_deviation))
        if not found or not isinstance(atom, Comparison):
            self._certain[slot] = predicate(atom, kinds)
            return
        left, right = sum_of(atom.left, kinds), sum_of(atom.right, kinds)
        difference = None if left is None or right is None else left.plus(right, -1.0)
        if difference is not None:
            if difference.factors:
                self._uncertain[slot] = _UncertainAtom(atom, difference, self.numbers)
            else:  # As of `X[a] - X[b]` if both are one object.
                compare = COMPARISONS[atom.operator]
                self._certain[slot] = lambda values: compare(_rest(atom, difference, values), 0)
            return
        self.is_linear = False
        distance = distance_of(atom, kinds)
        if distance is None:
            self.has_bounds = False
        else:
            self._distances[slot] = distance

    def _is_known(self, distance: DistanceAtom) -> bool:
        """Return True if the joint distribution of the numbers of a distance is known."""
        numbers = distance.numbers
        groups = {self._groups[self.numbers.index(each)] for each in numbers}
        is_independent = all(each.time_constant is not None for each in numbers)
        is_normal = all(type(each) is Uncertain for each in numbers)
        return is_normal and (is_independent or len(groups) == 1)

    def _chance_of_distance(
        self, distance: DistanceAtom, values: Values, moments: Moments
    ) -> Chance:
        numbers = list(map(self.numbers.index, distance.numbers))
        means = [moments[each][0] for each in numbers]
        covariances = [
            [self._covariance(first, second, values, moments) for second in numbers]
            for first in numbers
        ]
        found = distance.chance(values, means, covariances)
        if found is None:
            raise no_distribution(distance.numbers)
        return found

    def _components_of(self, mask: int) -> list[_Component]:
        """Return the components of the uncertain atoms in a mask."""
        if mask not in self._components:
            self._components[mask] = self._joined(mask)
        return self._components[mask]

    def _joined(self, mask: int) -> list[_Component]:
        found: list[tuple[set[int], dict[int, _UncertainAtom]]] = []
        for slot, atom in self._uncertain.items():
            if not mask >> slot & 1:
                continue
            groups, atoms = {self._groups[each] for each, _ in atom.direction}, {slot: atom}
            for known in [each for each in found if each[0] & groups]:
                groups |= known[0]
                atoms |= known[1]
                found.remove(known)
            found.append((groups, atoms))
        return [_Component(atoms, len(groups) == 1) for groups, atoms in found]

    def moments(self, values: Values) -> Moments:
        """Return the mean and the deviation of each uncertain number at a state.

        Raises:
            ReasoningError: if a mean or a deviation is not a usable number.
        """
        found = [(mean(values), deviation(values)) for mean, deviation in self._readers]
        for index, (mean, deviation) in enumerate(found):
            if not (isfinite(mean) and 0 <= deviation < inf):
                raise UnusableValueError(
                    f"of '{self.numbers[index]}', the estimate is {mean} and the deviation "
                    f'{deviation}; both must be finite, and the deviation not negative'
                )
        return found

    def cells(self, mask: int, values: Values, moments: Moments) -> Cells:
        """Return the possible truths of the atoms in a mask, if errors are independent.

        Raises:
            ReasoningError: if there are too many, or a value is unusable.
        """
        certain = self._certain_bits(mask, values)
        parts = [self._cells_of(each, values, moments) for each in self._components_of(mask)]
        if prod(map(len, parts)) > MAX_CELLS:
            raise ReasoningError(
                f'the atoms of the formula have more than {MAX_CELLS} truths at a state; ask for '
                'the probability of fewer at a time'
            )
        if len(parts) == 1:
            return [(certain | bits, chance) for bits, chance in parts[0]]
        return [
            (certain | sum(bits for bits, _ in chosen), prod(chance for _, chance in chosen))
            for chosen in product(*parts)
        ]

    def chance(self, node: Node, values: Values, moments: Moments) -> Chance:
        """Return the probability of a formula without temporal operators.

        Raises:
            ReasoningError: if a value is unusable.
        """
        components = self._components_of(node.mask)
        has_sums = not any(node.mask >> slot & 1 for slot in self._distances)
        is_known = has_sums and len(components) <= 1 and all(x.is_known for x in components)
        if is_known and any(map(self._is_bounded, components)):
            return self._possible(node, components[0], values, moments)
        if is_known or (self.is_independent and self.has_cells):
            return _known(self._total(node, self.cells(node.mask, values, moments)))
        match node:
            case Literal(slot, positive):
                if slot in self._distances:
                    found = self._chance_of_distance(self._distances[slot], values, moments)
                else:
                    found = self._marginal(self._uncertain[slot], values, moments)
                return found if positive else complement(found)
            case Junction(universal, parts):
                count = len(parts) if universal else 1
            case AtLeast(count, parts):
                pass
            case _:  # pragma: no cover - there are no others
                raise AssertionError(node)
        return at_least(count, [self.chance(each, values, moments) for each in parts])

    def _total(self, node: Node, cells: Cells) -> float:
        if type(node) is Constant:
            return float(node.value)
        return sum(chance for symbol, chance in cells if holds_at(node, symbol))

    def _is_bounded(self, component: _Component) -> bool:
        """Return True if a known component has a bounded error."""
        return isinstance(self.numbers[component.direction[0][0]], Bounded)

    def _possible(
        self, node: Node, component: _Component, values: Values, moments: Moments
    ) -> Chance:
        """Return the probability of a formula about one number whose error is bounded."""
        ((number, _),) = component.direction
        mean, error = moments[number]
        thresholds = component.thresholds(values)
        lowest, highest = mean - error, mean + error
        inner = {each for each in thresholds.values() if lowest < each < highest}
        points = sorted({lowest, highest, *inner})
        points += [(first + last) / 2 for first, last in pairwise(points)]
        certain = self._certain_bits(node.mask, values)
        truths = {holds_at(node, certain | component.bits_at(x, thresholds)) for x in points}
        return float(all(truths)), float(any(truths))

    def _certain_bits(self, mask: int, values: Values) -> int:
        bits = 0
        for slot, holds in self._certain.items():
            if mask >> slot & 1 and holds(values):
                bits |= 1 << slot
        return bits

    def _cells_of(
        self, component: _Component, values: Values, moments: Moments
    ) -> list[tuple[int, float]]:
        """Return the cells of atoms that compare one sum."""
        atoms, direction = component.atoms, component.direction
        mean = sum(factor * moments[number][0] for number, factor in direction)
        deviation = self._deviation(direction, values, moments)
        thresholds = component.thresholds(values)
        if not deviation:
            return [(component.bits_at(mean, thresholds), 1.0)]
        found = []
        for first, last in pairwise((-inf, *sorted(set(thresholds.values())), inf)):
            chance = _between((first - mean) / deviation, (last - mean) / deviation)
            if chance:
                bits = 0
                for slot, atom in atoms.items():
                    is_below = last <= thresholds[slot]
                    if atom.operator in (_LESS if is_below else _GREATER):
                        bits |= 1 << slot
                found.append((bits, chance))
        return found

    def covariance_matrices(
        self, values: Values, moments: Moments
    ) -> Iterator[tuple[Sequence[int], list[list[float]]]]:
        """Yield the numbers of each group with several, and the covariances of their errors."""
        for group in sorted({self._groups[first] for first, _ in self._covariances}):
            members = [each for each, found in enumerate(self._groups) if found == group]
            rows = (
                [self._covariance(first, second, values, moments) for second in members]
                for first in members
            )
            yield members, list(rows)

    def _covariance(self, first: int, second: int, values: Values, moments: Moments) -> float:
        largest = moments[first][1] * moments[second][1]
        if first == second:
            return largest
        read = self._covariances.get((min(first, second), max(first, second)))
        if read is None:
            return 0.0
        found: float = read(values)
        if not abs(found) <= largest * (1 + TOLERANCE):
            raise UnusableValueError(
                f"the covariance of '{self.numbers[first].mean}' and "
                f"'{self.numbers[second].mean}' is {found}, more than the product of their "
                'deviations'
            )
        return found

    def _deviation(
        self, direction: Sequence[tuple[int, float]], values: Values, moments: Moments
    ) -> float:
        """Return the deviation of a sum, if errors without covariances are independent."""
        spreads = [factor * moments[number][1] for number, factor in direction]
        found = hypot(*spreads)
        if not self._covariances:
            return found
        variance, largest = found * found, sum(map(abs, spreads))
        for (first, one), (second, other) in combinations(direction, 2):
            variance += 2 * one * other * self._covariance(first, second, values, moments)
        if variance < -TOLERANCE * largest * largest:
            raise no_distribution([self.numbers[number] for number, _ in direction])
        return sqrt(max(0.0, variance))

    def _marginal(self, atom: _UncertainAtom, values: Values, moments: Moments) -> Chance:
        """Return the probability of an atom, whatever the dependence of its numbers."""
        mean = sum(factor * moments[number][0] for number, factor in atom.direction)
        error, deviation, count = 0.0, 0.0, 0
        for direction in atom.directions:
            number, factor = direction[0]
            spread = abs(factor) * moments[number][1]
            if len(direction) > 1:
                spread = self._deviation(direction, values, moments)
            if isinstance(self.numbers[number], Bounded):
                error += spread
            elif spread:
                deviation, count = deviation + spread, count + 1
        distance = atom.threshold(values) - mean
        if not count:
            return _chance_within(atom.operator, distance, error)
        if atom.operator == '=':
            # Numbers that depend on each other may differ by a constant.
            return (0.0, 0.0) if count == 1 and not error else (0.0, 1.0)
        least, most = (distance - error) / deviation, (distance + error) / deviation
        below = (max(0.0, 1.0 - count * _below(-least)), min(1.0, count * _below(most)))
        return below if atom.operator in _LESS else complement(below)


def _rest(atom: Comparison, difference: Sum, values: Values) -> float:
    """Return the certain part of the left side of a comparison minus its right side."""
    found: float = sum(factor * read(values) for factor, read in difference.rest)
    if found != found:  # noqa: PLR0124 - only NaN differs from itself
        raise UnusableValueError(f"the sides of '{atom}' are infinite; compare finite numbers")
    return found


def no_distribution(numbers: Iterable[Uncertain]) -> ReasoningError:
    """Return the error of covariances that no distribution has."""
    names = ', '.join(f"'{each.mean}'" for each in numbers)
    return UnusableValueError(
        f'the covariances of {names} are those of no distribution: a sum of these would have a '
        'negative variance'
    )


def _covariances(
    numbers: Sequence[Uncertain], kinds: Kinds
) -> dict[tuple[int, int], Callable[[Values], Any]]:
    """Return what reads the covariance of two numbers, by their indices in order."""
    found: dict[tuple[int, int], Callable[[Values], Any]] = {}
    for first, number in enumerate(numbers):
        for covariance in number.covariances:
            for second, other in enumerate(numbers):
                if second == first or other.mean != covariance.left:
                    continue
                names = f"'{number.mean}' and '{other.mean}'"
                if type(other) is not Uncertain or other.time_constant != number.time_constant:
                    raise ReasoningError(
                        f'{names} have a covariance, so both have normal errors that last equally '
                        'long; give both the same time constant, or none'
                    )
                pair = min(first, second), max(first, second)
                if pair in found:
                    raise ReasoningError(f'{names} have two covariances; give one')
                found[pair] = term_reader(covariance.right, kinds)
    return found


def _groups(
    numbers: Sequence[Uncertain], covariances: Mapping[tuple[int, int], Any]
) -> Sequence[int]:
    """Return the group of each number: the index of the first number of the group."""
    related = [{each} for each in range(len(numbers))]
    for first, second in covariances:
        related[first].add(second)
        related[second].add(first)
    for first, second in covariances:
        for third in related[first] ^ related[second]:
            lacking = numbers[second if third in related[first] else first]
            raise ReasoningError(
                f"'{lacking.mean}' and '{numbers[third].mean}' have covariances with one number; "
                'give theirs, too'
            )
    return list(map(min, related))


def _chance_within(operator: str, distance: float, error: float) -> Chance:
    """Return the probability that an error of at most `error` compares so with a distance."""
    compare = COMPARISONS[operator]
    if operator == '=':
        return float(distance == error == 0), float(abs(distance) <= error)
    sides = compare(-error, distance), compare(error, distance)
    return float(all(sides)), float(any(sides))


def _known(chance: float) -> Chance:
    chance = min(1.0, chance)
    return chance, chance
