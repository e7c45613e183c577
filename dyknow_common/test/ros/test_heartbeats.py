"""The liveliness of a node, from its signs of life and the periods of the reader."""

from __future__ import annotations

from dyknow_common.ros.liveliness import MISSED_LIMIT, NodeLiveliness


def test_a_node_without_a_sign_of_life_is_not_alive() -> None:
    assert NodeLiveliness().alive_since == 0


def test_a_node_dies_after_a_number_of_periods() -> None:
    node = NodeLiveliness()
    node.note(7)
    node.silence += MISSED_LIMIT - 1
    assert node.alive_since == 7
    node.silence += 1
    assert node.alive_since == 0
    node.note(7)
    assert node.alive_since == 7


def test_a_restarted_node_is_another_run() -> None:
    node = NodeLiveliness()
    node.note(7)
    node.silence += 2
    node.note(9)
    assert (node.alive_since, node.silence) == (9, 0)


def test_a_second_node_is_ignored_while_the_first_one_is_alive() -> None:
    for first, second in ((9, 7), (7, 9)):
        node = NodeLiveliness()
        node.note(first)
        node.silence += 1
        node.note(second)
        assert (node.alive_since, node.silence) == (first, 1)
        node.silence += MISSED_LIMIT
        node.note(second)
        assert node.alive_since == second
