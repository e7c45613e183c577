"""Simplification of nodes: windows over one body, and parts that repeat their siblings."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    Bound,
    Chronology,
    Junction,
    Node,
    Window,
    constant,
)
from dyknow_reasoning.progression.residual import residual_text

HORIZON = 30
Span = tuple[int, int]


class Drawn:
    """Nodes of one store; a window from -1 has come to its start, one to the horizon has no end."""

    def __init__(self) -> None:
        self.store = NodeStore(Chronology())
        self.p, self.q, self.r = (self.store.literal(each, positive=True) for each in range(3))

    def window(self, span: Span, body: Node, *, universal: bool) -> Node:
        start, end = (Bound(0, each) if -1 < each < HORIZON else None for each in span)
        return self.store.window(
            start, end, constant(value=not universal), body, universal=universal
        )


def spans(node: Node, *, universal: bool) -> list[Span]:
    """The windows of one kind in a junction, or alone."""
    found = node.parts if type(node) is Junction else (node,)
    windows = [each for each in found if type(each) is Window and each.universal is universal]
    ends = [(each.start, each.end) for each in windows]
    return sorted(
        (-1 if a is None else a.offset, HORIZON if b is None else b.offset) for a, b in ends
    )


def within(inner: Span, outer: Span) -> bool:
    return outer[0] <= inner[0] and inner[1] <= outer[1]


SPANS = st.lists(
    st.tuples(st.integers(-1, 20), st.sampled_from([0, 1, 2, 3, 5, 8, HORIZON])).map(
        lambda each: (each[0], min(HORIZON, each[0] + each[1] + (each[0] < 0)))
    ),
    min_size=2,
    max_size=6,
)


@given(SPANS, SPANS, st.booleans())
def test_windows_over_one_body(first: list[Span], second: list[Span], universal: bool) -> None:  # noqa: FBT001
    """As sets of times: windows of the junction's kind are joined, of others the innermost stay."""
    make = Drawn()
    own = [make.window(each, make.p, universal=universal) for each in first]
    others = [make.window(each, make.p, universal=not universal) for each in second]
    node = make.store.junction(own + others, universal=universal)
    covered = {time for low, high in first for time in range(low, high + 1)}
    edges = [time for time in sorted(covered) if time - 1 not in covered]
    runs = [
        (low, next(each for each in range(low, 99) if each + 1 not in covered)) for low in edges
    ]
    innermost = {each for each in second if not any(within(a, each) for a in second if a != each)}
    assert spans(node, universal=universal) == runs
    assert spans(node, universal=not universal) == sorted(innermost)
    # What contradicts a window is within it.
    bodies = [make.window(each, make.p, universal=universal) for each in second]
    node = make.store.junction([*own, *map(make.store.negation, bodies)], universal=universal)
    is_decided = any(within(each, run) for each in second for run in runs)
    assert (node is constant(value=not universal)) == is_decided


@pytest.mark.parametrize('universal', [True, False])
def test_parts_that_repeat_their_siblings(universal: bool) -> None:  # noqa: FBT001
    make = Drawn()

    def join(*parts: Node, own: bool = True) -> Node:
        return make.store.junction(parts, universal=universal is own)

    def other(*parts: Node) -> Node:
        return join(*parts, own=False)

    def windows(span: Span) -> tuple[Node, Node]:
        return (
            make.window(span, make.p, universal=universal),
            make.window(span, make.p, universal=not universal),
        )

    p, q, r = make.p, make.q, make.r
    (outer, wide), (inner, narrow) = windows((1, 9)), windows((2, 8))
    for before, after in (
        (join(p, other(p, q)), p),
        (join(p, other(q, join(p, r))), join(p, other(q, r))),
        (join(p, q, other(r, join(p, q))), join(p, q)),
        (join(outer, other(q, inner)), outer),
        (join(narrow, other(q, wide)), narrow),
        (join(p, make.store.negation(p), q), constant(value=not universal)),
        (join(), constant(value=universal)),
    ):
        assert before is after, residual_text(before, ('p', 'q', 'r'))
    for kept in (join(inner, other(q, outer)), join(wide, other(q, narrow))):
        assert type(kept) is Junction
        assert len(kept.parts) == 2


@pytest.mark.parametrize(
    ('start', 'right', 'expected'),
    [(0, TRUE, TRUE), (0, FALSE, FALSE), (1, FALSE, FALSE), (None, FALSE, FALSE), (1, TRUE, None)],
)
def test_constants_in_the_past(start: int | None, right: Node, expected: Node | None) -> None:
    make = Drawn()
    for node, found in (
        (make.store.past_window(start, None, make.p, right, universal=False), expected),
        (
            make.store.past_window(start, None, make.p, make.store.negation(right), universal=True),
            expected and make.store.negation(expected),
        ),
    ):
        assert node is found or (found is None and node.looks_back)


def test_counts() -> None:
    make = Drawn()
    p, q, r = make.p, make.q, make.r
    for count, members, negated in (
        (2, (p, q, r), 2),
        (2, (p, p, q, r), 3),
        (3, (p, p, q, r), 2),
    ):
        few = make.store.negation(make.store.at_least(count, members))
        assert few is make.store.at_least(negated, map(make.store.negation, members))
    assert make.store.at_least(2, (p, p, p)) is p
