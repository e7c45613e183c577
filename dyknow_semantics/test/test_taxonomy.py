"""The order of concepts, against a closure that is computed step by step."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dyknow_semantics.ontology.taxonomy import Taxonomy

NODES = [f'c{number}' for number in range(6)]
PAIRS = st.lists(st.tuples(st.sampled_from(NODES), st.sampled_from(NODES)), max_size=12)


def closure(pairs: list[tuple[str, str]]) -> set[tuple[str, str]]:
    """The reflexive and transitive closure, by adding what follows until nothing does."""
    relation = {(node, node) for node in NODES} | set(pairs)
    while True:
        new = {(a, d) for a, b in relation for c, d in relation if b == c} - relation
        if not new:
            return relation
        relation |= new


@given(PAIRS)
def test_above_and_below_are_the_closure(pairs: list[tuple[str, str]]) -> None:
    taxonomy = Taxonomy(pairs)
    relation = closure(pairs)
    for node in NODES:
        assert taxonomy.above(node) == {above for below, above in relation if below == node}
        assert taxonomy.below(node) == {below for below, above in relation if above == node}


@given(PAIRS)
def test_the_specific_come_first(pairs: list[tuple[str, str]]) -> None:
    taxonomy = Taxonomy(pairs)
    relation = closure(pairs)
    ordered = taxonomy.specific_first(NODES)
    assert sorted(ordered) == NODES
    for earlier, later in ((a, b) for i, a in enumerate(ordered) for b in ordered[i + 1 :]):
        strictly_below = (later, earlier) in relation and (earlier, later) not in relation
        assert not strictly_below
