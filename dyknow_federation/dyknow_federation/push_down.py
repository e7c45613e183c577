"""Push-down: the parts of a formula that are about the streams of one peer are evaluated there.

Example: three robots are peers, and in a formula about all of them,

    forall r in Robot: always (Charge[r] < 0.2 -> eventually[0 s, 1 min] Docked[r])

each robot evaluates its own instance, with its own streams and by its own clock:

    always (Charge_r1.value < 0.2 -> eventually[0 s, 1 min] Docked_r1.value)

Only the verdict crosses, as a stream of text: `undecided` or, if it would be false without further
states, `presumably false`; then `true` or `false`, with the reason. What remains here is
`v1 and v2 and v3`. Each of these parts is presumably false while its peer's verdict is:

    verdict starts with "true" release
    (not verdict starts with "false" and eventually verdict != "presumably false")

A part contains an operator of time, and no operator of time contains it: so it begins when the
formula begins, and is decided once. The same formula over the same samples would have the same
verdict here, but for the bounds of the clocks: its host needs none. What remains here does not know
that two parts contradict each other, so its verdict may come later than the whole formula's.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from dyknow_common import SECOND_NS, DyKnowError, shortened
from dyknow_federation.encoding import MAX_LENGTH
from dyknow_federation.errors import FederationError
from dyknow_federation.offers import VALUE
from dyknow_reasoning import (
    And,
    Arithmetic,
    Comparison,
    Connective,
    Count,
    CountOf,
    Exists,
    Feature,
    FieldReference,
    Forall,
    Formula,
    Function,
    FutureFormula,
    Implies,
    Not,
    Number,
    Object,
    Or,
    PastFormula,
    TextLiteral,
    Truth,
    Variable,
    check_types,
    joined,
    parse_formula,
    walk,
    with_changed_parts,
)

UNDECIDED: Final = 'undecided'
"""The verdict of a peer that knows none yet."""

PRESUMABLY_FALSE: Final = 'presumably false'
"""Its verdict if the formula would be false without further states."""

_TRUE: Final = 'true'
_FALSE: Final = 'false'

MAX_TIMEOUT: Final = 365 * 86_400 * SECOND_NS
"""How long a peer evaluates a part at most, in nanoseconds."""

MAX_NODES: Final = 10_000
"""The largest formula, for given objects, whose parts are pushed down."""

_EVALUATED: Final = (
    Connective | Not | CountOf | FutureFormula | PastFormula | Comparison | Arithmetic | Function
    | Feature | FieldReference | Object | Number | TextLiteral | Truth
)  # fmt: skip
"""What the parts for peers may consist of. Others depend on the ontology of this host, or on more
than the states from the first one on."""


@dataclass(frozen=True, slots=True)
class PeerPart:
    """A part of a formula, for given objects.

    Args:
        peer: the peer that evaluates the part.
        formula: the part in the words of this host.
        text: the text of the formula over the streams of the peer.
    """

    peer: str
    formula: Formula
    text: str


@dataclass(frozen=True, slots=True)
class _Hole(Truth):
    """The place of a part, in what remains of a formula."""

    part: PeerPart


class _TooLargeError(Exception):
    """A formula for given objects is too large."""


class PushDown:
    """A formula whose parts for peers are found.

    Args:
        formula: without units.
        domains: the objects of its sorts.
        streams: the ground features, `Charge[r1]`, that come from streams of peers: the names of
            peer and stream.

    Attributes:
        parts: what peers evaluate.
    """

    def __init__(
        self,
        formula: Formula,
        domains: Mapping[str, Sequence[str]],
        streams: Mapping[str, tuple[str, str]],
    ) -> None:
        self._domains = domains
        self._streams = streams
        self._left = MAX_NODES
        try:
            self._remaining = self._without_parts(formula)
        except _TooLargeError:
            self._remaining = formula
        holes = (each for each in walk(self._remaining) if isinstance(each, _Hole))
        self.parts = tuple(dict.fromkeys(each.part for each in holes))

    def remaining(self, topics: Mapping[PeerPart, str]) -> str:
        """Return the formula over the verdicts of peers, on their topics.

        Parts that have no topic are evaluated here. The result is empty if the formula names an
        object that no text can name, such as `r-1`, or that has the name of a variable.
        """
        return _text(_filled(self._remaining, topics))

    def _without_parts(self, node: Formula) -> Formula:
        """Return a closed formula with holes for the parts of peers."""
        hole = self._part([self._instance(node, {})])
        if hole is not None:
            return hole
        match node:
            case Connective() | Not():
                changed: Formula = with_changed_parts(node, self._without_parts)
                return changed
            case Forall() | Exists():
                return self._without_instances(node)
        return node

    def _without_instances(self, node: Forall | Exists) -> Formula:
        """Return a quantified formula with a hole for the instances of each peer."""
        join: type[And | Or] = And if isinstance(node, Forall) else Or
        found: dict[str, list[tuple[str, Formula]]] = {}
        for name in self._domains[node.sort]:
            instance = self._instance(node.body, {node.variable: name})
            peer = self._peer([instance])
            if peer is not None:
                found.setdefault(peer, []).append((name, instance))
        holes: list[Formula] = []
        pushed: list[str] = []
        for own in found.values():
            if hole := self._part([each for _, each in own], join):
                holes.append(hole)
                pushed += [name for name, _ in own]
        if not holes:
            return node
        if len(pushed) < len(self._domains[node.sort]):
            variable = Variable(node.variable)
            others = joined([Comparison('!=', variable, Object(each)) for each in pushed], And)
            body = (Implies if join is And else And)(others, node.body)
            holes.append(type(node)(node.variable, node.sort, body))
        return joined(holes, join)

    def _part(self, instances: Sequence[Formula], join: type[And | Or] = And) -> _Hole | None:
        """Return a hole for instances that one peer can evaluate, unless they are too long."""
        peer = self._peer(instances)
        if peer is None:
            return None
        formula = joined(instances, join)
        text = _text(self._over_streams(formula))
        is_short = 0 < len(text.encode()) <= MAX_LENGTH
        return _Hole(True, PeerPart(peer, formula, text)) if is_short else None

    def _peer(self, instances: Sequence[Formula]) -> str | None:
        """Return the peer with the streams of all features, if time matters to all instances."""
        nodes = [[*walk(each)] for each in instances]
        if not all(any(isinstance(each, FutureFormula) for each in found) for found in nodes):
            return None
        times = [each for found in nodes for each in found if isinstance(each, FutureFormula)]
        if any(each.interval.start > MAX_TIMEOUT for each in times):
            return None  # There will be no verdict: a guard asks for the values in this way.
        peers: set[str | None] = set()
        for node in (each for found in nodes for each in found):
            if not isinstance(node, _EVALUATED) or isinstance(node, FieldReference):
                return None
            if isinstance(node, Feature):
                peers.add(self._streams.get(str(node), (None,))[0])
        return peers.pop() if len(peers) == 1 else None

    def _over_streams(self, node: Any) -> Any:
        if isinstance(node, Feature):
            return FieldReference(self._streams[str(node)][1], VALUE)
        return with_changed_parts(node, self._over_streams)

    def _instance(self, node: Any, objects: Mapping[str, str]) -> Any:
        """Return a node for given objects of its variables, without quantifiers.

        Raises:
            _TooLargeError: if too much has been written out.
        """
        self._left -= 1
        if self._left < 0:
            raise _TooLargeError
        match node:
            case Variable(name) if name in objects:
                return Object(objects[name])
            case Forall() | Exists() | Count():
                bodies = [
                    self._instance(node.body, {**objects, node.variable: name})
                    for name in self._domains[node.sort]
                ]
                return _quantified(node, bodies)
        found = with_changed_parts(node, partial(self._instance, objects=objects))
        match found:
            case Comparison(operator, Object(left), Object(right)):
                return Truth((left == right) is (operator == '='))
        return found


def _quantified(node: Forall | Exists | Count, bodies: Sequence[Formula]) -> Formula:
    if isinstance(node, Count):
        return CountOf(node.bound, node.number, tuple(bodies))
    return joined(bodies, And if isinstance(node, Forall) else Or)


def _text(formula: Formula) -> str:
    """Return the text of a formula; empty if it would be refused or read as another one."""
    text = str(formula)
    try:
        found = parse_formula(text)
        check_types(found, text)
    except DyKnowError:
        return ''
    return text if found == formula else ''


def _filled(node: Any, topics: Mapping[PeerPart, str]) -> Any:
    if not isinstance(node, _Hole):
        return with_changed_parts(node, partial(_filled, topics=topics))
    if node.part not in topics:
        return node.part.formula
    verdict = f'"{topics[node.part]}".{VALUE}'
    return parse_formula(
        f'{verdict} starts with "{_TRUE}" release (not {verdict} starts with "{_FALSE}" '
        f'and eventually {verdict} != "{PRESUMABLY_FALSE}")'
    )


def verdict_text(*, is_true: bool, reason: str) -> str:
    """Return what a peer is told of a formula that is decided; a long reason is cut."""
    verdict = _TRUE if is_true else _FALSE
    text = f'{verdict}: {reason}' if reason else verdict
    return text.encode(errors='replace')[:MAX_LENGTH].decode(errors='ignore')


def streams_of(formula: str, shared: Collection[str]) -> frozenset[str]:
    """Return the streams that a formula of a peer is about.

    Args:
        formula: as in `PeerPart.text`.
        shared: the streams that it may be about.

    Raises:
        FederationError: if it is no such formula.
    """
    try:
        nodes = [*walk(parse_formula(formula))]
    except DyKnowError as error:
        raise FederationError(f"'{shortened(formula)}' is no formula here: {error}") from None
    wrong = next((each for each in nodes if not isinstance(each, _EVALUATED)), None)
    if wrong is not None or any(isinstance(each, Feature) for each in nodes):
        raise FederationError(f"'{shortened(formula)}' is not about streams alone")
    found = frozenset(each.stream for each in nodes if isinstance(each, FieldReference))
    if missing := sorted(found - {*shared}):
        raise FederationError(f"'{shortened(missing[0])}' is not shared; name it in share there")
    return found


def with_prefix(formula: str, prefix: str) -> str:
    """Return a formula of a peer over the streams whose names have a prefix here."""

    def renamed(node: Any) -> Any:
        if isinstance(node, FieldReference):
            return FieldReference(prefix + node.stream, node.path)
        return with_changed_parts(node, renamed)

    return str(renamed(parse_formula(formula)))
