"""The requests of a subscription to publishers that come and go."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from dyknow_stream_processing.ros.topics.publications import Publication, next_request

PUBLISHERS = st.frozensets(st.tuples(st.integers(1, 4)), min_size=1)
FOUND = st.builds(Publication, st.sampled_from(['a/msg/A', 'b/msg/B']), PUBLISHERS)
OFFERS = st.builds(
    lambda found, reliable, latched: replace(found, reliable=reliable, latched=latched),
    FOUND,
    st.booleans(),
    st.booleans(),
)


@given(st.lists(OFFERS, min_size=1))
def test_every_publisher_matches(offers: list[Publication]) -> None:
    held = None
    for found in offers:
        held = next_request(held, found)
        assert (held.type_name, held.publishers) == (found.type_name, found.publishers)
        assert found.reliable or not held.reliable
        assert found.latched or not held.latched


@given(OFFERS, st.lists(OFFERS, min_size=1))
def test_nothing_is_received_twice(first: Publication, others: list[Publication]) -> None:
    """While a publisher stays, a new subscription does not request the messages that it kept."""
    held = first
    for found in others:
        staying = replace(
            found, type_name=first.type_name, publishers=found.publishers | first.publishers
        )
        before, held = held, next_request(held, staying)
        assert before.suits(held) or not held.latched


def test_what_a_publisher_kept_is_received_if_it_is_found_after_the_subscription() -> None:
    latched = Publication('a/msg/A', frozenset({(1,)}), latched=True)
    assert next_request(Publication('a/msg/A'), latched) == latched


def test_other_publishers_are_matched_again() -> None:
    weak = Publication('a/msg/A', frozenset({(1,)}), reliable=False)
    strong = Publication('a/msg/A', frozenset({(2,)}), latched=True)
    assert next_request(weak, strong) == strong


def test_a_stronger_publisher_is_no_reason_to_subscribe_again() -> None:
    weak = Publication('a/msg/A', frozenset({(1,)}), reliable=False)
    both = Publication('a/msg/A', frozenset({(1,), (2,)}), reliable=False)
    strong = replace(weak, reliable=True)
    assert next_request(next_request(weak, both), strong) == weak
