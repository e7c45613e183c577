"""Explanation of a verdict, for the operators of the robot.

The explanation follows from the remaining formula before the deciding state and from this state.
The only data kept for it are the opening times of the windows without an end.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod

from dyknow_common import (
    COMPARISONS,
    MIRRORED_COMPARISONS,
    TEXT_COMPARISONS,
    SymbolKind,
    Value,
    Verdict,
    format_time,
    printable,
)
from dyknow_reasoning.execution import (
    DecidingMoment,
    Histories,
    InstanceVerdict,
    PossibleVerdict,
    past_terms,
    value_field,
)
from dyknow_reasoning.explanation.facts import (
    PastStates,
    SpatialFact,
    past_fact,
    shortened_text,
)
from dyknow_reasoning.explanation.remainders import windows_of_known_origin
from dyknow_reasoning.language.formula import (
    Comparison,
    Exists,
    Forall,
    Formula,
    FutureFormula,
    PastAtom,
    outermost_foralls,
    walk,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.spatial import SpatialAtom
from dyknow_reasoning.language.symbols import symbols_of
from dyknow_reasoning.language.terms import (
    Number,
    Probability,
    Quantity,
    ShownQuantity,
    Term,
    TextLiteral,
    Truth,
)
from dyknow_reasoning.language.writing import as_written
from dyknow_reasoning.progression.atoms import (
    Values,
    evaluate,
)
from dyknow_reasoning.progression.instances import wording_of, written_atoms
from dyknow_reasoning.progression.nodes import (
    TRUE,
    AtLeast,
    Bound,
    Constant,
    Junction,
    Literal,
    Node,
    PastWindow,
    Remembering,
    Sides,
    Window,
    constant,
    descendants,
    sides,
)
from dyknow_reasoning.progression.progression import Progression
from dyknow_reasoning.progression.residual import (
    Wording,
    awaited_comparison,
    interval_of,
    parts_in_order,
    remaining_text,
    residual_text,
)
from dyknow_reasoning.progression.sizes import Counts

_MAX_REASONS = 4
_LITERALS = (Number, TextLiteral, Truth)

_MAX_WHOLE = 1e9
"""Whole numbers from here on are shown with an exponent."""

_DIGITS = (4, 9)
"""The digits of a converted number in reasons: more only if a claim needs them."""


@dataclass(frozen=True, slots=True)
class VerdictReasons:
    """The reasons of a verdict, for the operators of the robot.

    Args:
        text: the reasons, with objects, values, and the times of pending obligations.
        objects: the instance that decides the formula, `u = uav1`; empty if it has no variables.
        windows: the intervals in which the operators that the text names must hold or are
            awaited, in nanoseconds; to the deciding state if they have no end.
    """

    text: str
    objects: str = ''
    windows: tuple[tuple[int, int], ...] = ()


def without_states(formula: Formula, verdict: Verdict) -> VerdictReasons:
    """Return the reason of a verdict that needs no state."""
    sorts = dict.fromkeys(s.name for s in symbols_of(formula) if s.kind is SymbolKind.SORT)
    objects = f' for the objects of {" and ".join(sorts)}' if sorts else ''
    return VerdictReasons(f'it is {verdict.name.lower()}{objects}, whatever the states are')


def explain(
    formula: Formula,
    counts: Counts,
    verdict: InstanceVerdict | PossibleVerdict,
    values: Values,
    histories: Histories,
) -> VerdictReasons:
    """Return the reasons of a verdict.

    Args:
        formula: the formula.
        counts: the number of objects of each sort.
        verdict: the verdict on the instance that decides the formula.
        values: the values of the deciding state.
        histories: the histories that the formula looks back to.
    """
    instance = verdict.instance
    windows: Mapping[tuple[int, int], None] = {}
    if (moment := verdict.moment) is not None:
        explainer = _Explainer(formula, moment, values, histories)
        why, windows = explainer.text(), explainer.windows
        if isinstance(verdict, PossibleVerdict):
            why = f'{why}; so it is {verdict.whatever}'
    elif isinstance(verdict, PossibleVerdict):
        why = str(verdict)
    else:
        why = f'what remained can only be {verdict.holds}'.lower()
    why = f'{scope_text(formula, counts, instance.binding, holds=verdict.holds)}{why}'
    if instance.gap is not None:
        why = f'{why}; so it is whatever the states were that are missing {instance.gap}'
    return VerdictReasons(why, objects_text(instance.binding), tuple(windows))


class _Explainer:
    """Explains why a state decides a node, by progressing the parts of the node."""

    def __init__(
        self, formula: Formula, moment: DecidingMoment, values: Values, histories: Histories
    ) -> None:
        before = moment.before
        self._histories = histories
        # The intervals of the windows that the reasons name, in their order.
        self.windows: dict[tuple[int, int], None] = {}
        self._before = before
        self._symbol = moment.symbol
        self._values = values
        self._now, self._previous = moment.valid_time, moment.previous
        self._times = (*before.times, moment.valid_time)
        self._kept = moment.kept
        self._progression = Progression([before.node, *self._kept.values()])
        self._progression.begin(moment.symbol, self._times, self._kept)
        # Finds what past operators are at this state.
        self._progression.advance(before.node, fresh=before.is_fresh)
        self._progressed = self._progression.progress
        self._atoms = before.instance.atoms
        self._written_atoms = written_atoms(before.instance)
        self._intervals = _intervals(before.instance.node)
        # Simplification may have joined some of these intervals.
        self._stated_intervals = {
            each.interval for each in walk(formula) if isinstance(each, FutureFormula)
        }

    def text(self) -> str:
        """Return the reasons, shortened."""
        found = self._reasons(self._before.node, fresh=self._before.is_fresh)
        reasons = list(dict.fromkeys(found))
        shown = '; '.join(reasons[:_MAX_REASONS])
        more = len(reasons) - _MAX_REASONS
        return f'{shown}; and {more} more' if more > 0 else shown

    @cached_property
    def _wording(self) -> Wording:
        return wording_of(self._before.instance)

    def _reasons(self, node: Node, *, fresh: bool) -> list[str]:
        """Return the reasons why the state decides a node."""
        match node:
            case Literal():
                return self._reasons_of_literal(node)
            case Junction() | AtLeast():
                return self._reasons_of_parts(node, fresh=fresh)
            case Window():
                return self._reasons_of_window(node, fresh=fresh)
            case Remembering():
                return self._reasons(node.formula, fresh=fresh)
            case PastWindow():
                holds = self._progressed(node, fresh=True) is TRUE
                text = shortened_text(residual_text(node, self._written_atoms, self._wording))
                return [f"'{text}' is {str(holds).lower()} at {format_time(self._now)}"]
            case Constant():
                return [f'there is a state at {format_time(self._now)}']

    def _reasons_of_literal(self, node: Literal) -> list[str]:
        if body := self._kept.get(node.slot):
            body = body if node.positive else self._progression.store.negation(body)
            return self._reasons(body, fresh=True)
        return [self._fact(node)]

    def _whatever_follows(self, node: Junction | AtLeast, *, fresh: bool) -> str:
        verdict = self._progressed(node, fresh=fresh)
        whatever = f'is {str(verdict is TRUE).lower()} whatever states follow'
        return f"'{self._remaining(node, fresh=fresh)}' {whatever}"

    def _reasons_of_parts(self, node: Junction | AtLeast, *, fresh: bool) -> list[str]:
        verdict = self._progressed(node, fresh=fresh)
        parts = parts_in_order(node, self._atoms)
        deciding = [part for part in parts if self._progressed(part, fresh=fresh) is verdict]
        needed = 1
        if isinstance(node, AtLeast):
            needed = node.count if verdict is TRUE else len(parts) - node.count + 1
        elif verdict is constant(value=not node.universal):
            deciding = deciding[:1]
        if len(deciding) < needed:
            return [self._whatever_follows(node, fresh=fresh)]
        return [reason for part in deciding for reason in self._reasons(part, fresh=fresh)]

    def _reasons_of_window(self, node: Window, *, fresh: bool) -> list[str]:
        verdict = self._progressed(node, fresh=fresh)
        if verdict is constant(value=node.universal):
            if node.end is not None and self._time(node.end, fresh=fresh) <= self._now:
                return self._reasons_of_closed_window(node, node.end, fresh=fresh)
            sides = [node.left]
            # The right side has not decided the window either, if its interval has begun.
            neutral = constant(value=node.universal)
            begun = node.start is None or self._time(node.start, fresh=fresh) <= self._now
            if begun and self._progressed(node.right, fresh=True) is neutral:
                sides.append(node.right)
        else:
            sides = [node.right]
        # A side is smaller than the window, and cannot contradict it: so it is decided itself.
        found = (reason for side in sides for reason in self._reasons(side, fresh=True))
        reasons = list(dict.fromkeys(found))
        pending = '' if fresh else self._pending(node, after=sides == [node.right])
        return [f'{" and ".join(reasons)} ({pending})'] if pending else reasons

    def _reasons_of_closed_window(self, node: Window, end: Bound, *, fresh: bool) -> list[str]:
        """Return the reasons why the end of its interval decides a window."""
        last = self._time(end, fresh=fresh)
        # The window may join several; the last to start is known to reach the end.
        latest_start = max(interval.start for interval in self._intervals_of(node))
        start = node.start or Bound(end.state, latest_start)
        first = self._time(start, fresh=fresh)
        span = _span(first, last, Interval(start.offset, end.offset))
        self.windows[first, last] = None
        # An earlier state was not later than the end, or it would have decided the window.
        if (fresh or self._previous < first) and not first <= self._now <= last:
            return [f'there was no state {span}']
        right = shortened_text(residual_text(node.right, self._written_atoms, self._wording))
        if node.universal:
            return [f"'{right}' held at every state {span}"]
        now = self._reasons(node.right, fresh=True) if last == self._now else []
        return [f"'{right}' held at no state {span}", *now]

    def _pending(self, node: Window, *, after: bool) -> str:
        """Return what was pending since an earlier state; empty if that is not known.

        Args:
            node: a running window.
            after: True if only states after the start of its interval matter.
        """
        if awaited_comparison(node, self._written_atoms):
            return ''
        starts = {interval.start for interval in self._intervals_of(node)}
        origin = self._origin(node)
        if origin is None or len(starts) != 1:
            return ''
        start = starts.pop()
        if after and origin + start > self._now:
            return ''  # The window joins several, and the state is in the interval of another one.
        interval = Interval(start, None if node.end is None else node.end.offset)
        if start and interval not in self._stated_intervals:
            return ''
        decided = self._progressed(node, fresh=False)
        due = 'awaited' if decided is TRUE else 'must hold'
        shown = interval.suffix if start else ''
        end = self._now if node.end is None else self._time(node.end, fresh=False)
        self.windows[origin + start, end] = None
        return f'{_operator(node)}{shown} {due} since {format_time(origin)}'

    def _origin(self, node: Window) -> int | None:
        """Return the valid time of the state that reached a window; None if it is unknown."""
        if node.end is not None:
            return self._times[node.end.state]
        known = sides(node) in self._known_origins
        return self._before.window_origins.get(sides(node)) if known else None

    @cached_property
    def _known_origins(self) -> frozenset[Sides]:
        return windows_of_known_origin(self._before.instance.node)

    def _time(self, bound: Bound, *, fresh: bool) -> int:
        return (self._now if fresh else self._times[bound.state]) + bound.offset

    def _intervals_of(self, node: Window) -> set[Interval]:
        """Return the intervals in the formula that the present bounds of a window may stem from."""
        end = None if node.end is None else node.end.offset
        # With a kept value, a window is none of the formula, but one of its operators stated it.
        known = self._intervals[sides(node)]
        if self._before.instance.keeps_values and not known:
            known = self._stated_intervals
        return {each for each in known if each.end == end}

    def _remaining(self, node: Junction | AtLeast, *, fresh: bool) -> str:
        """Return the text of what remains of a node after this state."""
        progressed = [
            self._progressed(part, fresh=fresh) for part in parts_in_order(node, self._atoms)
        ]
        texts = [
            remaining_text(part, self._times, self._now, self._written_atoms, self._wording)
            for part in progressed
            if type(part) is not Constant
        ]
        if isinstance(node, AtLeast):
            count = node.count - progressed.count(TRUE)
            return shortened_text(f'at least {count} of ({", ".join(texts)})')
        word = ' and ' if node.universal else ' or '
        return shortened_text(word.join(f'({text})' for text in texts))

    def _fact(self, literal: Literal) -> str:
        """Return the value of an atom at this state, compared with its bound."""
        atom = self._atoms[literal.slot]
        time = format_time(self._now)
        if isinstance(atom, PastAtom):
            holds = bool(self._symbol >> literal.slot & 1)
            # States before this one may be missing in a gap.
            is_known = not self._before.is_fresh and self._before.instance.gap is None
            previous = self._previous if is_known else None
            if isinstance(comparison := atom.formula, Comparison):
                if any(isinstance(each, Probability) for each in past_terms(comparison)):
                    # Whether it is known to hold, and not to hold, are two atoms: a single fact.
                    comparison, holds = _stated(comparison, literal, holds=holds)
                return self._past_comparison(atom, comparison, holds=holds)
            if isinstance(atom.formula, SpatialAtom):
                truths = self._histories.spatial_truths(atom)
                fact = SpatialFact(atom.formula, truths, self._values).text(holds=holds)
                return f'at {time}, {fact}'
            states = PastStates(self._now, previous, self._histories.first_state(atom))
            return past_fact(as_written(atom.formula), states, holds=holds)
        if not isinstance(atom, Comparison):
            return f'{atom} is {_literal_text(self._values[str(atom)])} at {time}'
        comparison, holds = _stated(atom, literal, holds=bool(self._symbol >> literal.slot & 1))
        return self._compared(comparison, self._values, holds=holds)

    def _past_comparison(self, atom: PastAtom, comparison: Comparison, *, holds: bool) -> str:
        """Return the values of the past that a comparison depends on, and the comparison."""
        found = {each: self._values.get(value_field(atom, each)) for each in past_terms(comparison)}
        missing = next((each for each, value in found.items() if value is None), None)
        if missing is not None:
            shown = shortened_text(as_written(missing))
            return (
                f"'{shown}' has no value at {format_time(self._now)}, as there is no state before"
            )
        values = {str(each): value for each, value in found.items() if value is not None}
        return self._compared(comparison, {**self._values, **values}, holds=holds)

    def _compared(self, atom: Comparison, state: Values, *, holds: bool) -> str:
        operator, terms = atom.operator, (atom.left, atom.right)
        time = format_time(self._now)
        values = [evaluate(term, state) for term in terms]
        choices = (
            [_shown(*each, digits) for each in zip(terms, values, strict=True)]
            for digits in _DIGITS
        )
        # Values that differ must not look equal.
        shown = next((each for each in choices if _order(*each) == _order(*values)), values)
        first, second = map(_with_value, terms, shown)
        if operator in TEXT_COMPARISONS:
            verb = atom if holds else atom.opposite
            return f'{first} at {time} {verb.operator} {second}'
        if isinstance(atom.left, _LITERALS):
            operator, first, second = MIRRORED_COMPARISONS[operator], second, first
        if operator in {'=', '!='}:
            are_equal = (operator == '=') is holds
            return f'{first} at {time} is {"equal to" if are_equal else "not"} {second}'
        return f'{first} at {time} is {"" if holds else "not "}{operator} {second}'


def _stated(atom: Comparison, literal: Literal, *, holds: bool) -> tuple[Comparison, bool]:
    """Return the comparison that a literal states, and if it holds, given if its atom does."""
    return (atom, holds) if literal.positive else (atom.opposite, not holds)


def _order(left: Value, right: Value) -> tuple[bool, bool]:
    return left == right, COMPARISONS['<='](left, right)


def _with_value(term: Term, value: Value) -> str:
    text = str(as_written(term))
    match term, value:
        case Number(quantity=Quantity() as given), int() | float() if given != Quantity(
            term.value, term.unit
        ):
            return f'{ShownQuantity(value, term.unit)} ({text})'
        case Number() | TextLiteral() | Truth(), _:
            return text
    return f'{text} = {_literal_text(value)}'


def _shown(term: Term, value: Value, digits: int) -> Value:
    """Return a value with at most nine digits, or a converted number with fewer."""
    is_converted = isinstance(term, Number) and term.quantity is not None
    if not isinstance(value, float) or (isinstance(term, _LITERALS) and not is_converted):
        return value
    if not is_converted:
        return float(f'{value:.9g}')
    rounded = float(f'{value:.{digits}g}')
    return int(rounded) if rounded.is_integer() and abs(rounded) < _MAX_WHOLE else rounded


def _span(first: int, last: int, interval: Interval) -> str:
    """Return the times from `first` to `last`, with the brackets of an interval."""
    after, before = interval.excludes_start, interval.excludes_end
    start, end = format_time(first - after), format_time(last + before)
    return f'in {"(" if after else "["}{start}, {end}{")" if before else "]"}'


def _operator(node: Window) -> str:
    if node.left is constant(value=not node.universal):
        return 'always' if node.universal else 'eventually'
    return 'not until' if node.universal else 'until'


def _literal_text(value: Value) -> str:
    match value:
        case bool():
            return str(Truth(value))
        case str():
            return printable(str(TextLiteral(value)))
        case float():
            return repr(float(value))
        case _:
            return str(value)


def _intervals(node: Node) -> Mapping[Sides, set[Interval]]:
    intervals: defaultdict[Sides, set[Interval]] = defaultdict(set)
    for window in descendants([node]):
        if type(window) is Window:
            intervals[sides(window)].add(interval_of(window))
    return intervals


def objects_text(binding: Mapping[str, str]) -> str:
    """Return the text of a choice of objects: `u = uav1, v = uav2`."""
    return ', '.join(f'{variable} = {name}' for variable, name in binding.items())


def scope_text(formula: Formula, counts: Counts, binding: Mapping[str, str], *, holds: bool) -> str:
    """Return the beginning of an explanation: for which objects a formula is true or false.

    Args:
        formula: the formula.
        counts: the number of objects of each sort.
        binding: the choice of objects for the outermost `forall` that decided the formula.
        holds: the verdict.
    """
    every, body = outermost_foralls(formula)
    some: list[Exists] = []
    while isinstance(body, Exists):
        some.append(body)
        body = body.body
    objects = objects_text(binding)
    if holds and (all_choices := _choices(every, counts)):
        return f'for all {all_choices}, decided last for {objects}: '
    scope = f'for {objects}: ' if objects else ''
    if not holds and (no_choice := _choices(some, counts)):
        return f'{scope}for none of {no_choice}, decided last: '
    return scope


def _choices(quantifiers: Sequence[Forall | Exists], counts: Counts) -> str:
    """Return the number of choices of objects for quantifiers; empty if there is only one."""
    count = prod(counts.get(each.sort, 1) for each in quantifiers)
    if count < 2:  # noqa: PLR2004 - one choice needs no number
        return ''
    if len(quantifiers) == 1:
        return f'{count} objects of {quantifiers[0].sort}'
    return (
        f'{count} choices of {", ".join(f"{each.variable} in {each.sort}" for each in quantifiers)}'
    )
