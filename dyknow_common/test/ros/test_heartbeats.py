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
    node.note(9)
    assert node.alive_since == 9


def test_the_older_of_two_nodes_is_ignored_while_the_younger_is_alive() -> None:
    node = NodeLiveliness()
    node.note(9)
    node.silence += 1
    node.note(7)
    assert (node.alive_since, node.silence) == (9, 1)
    node.silence += MISSED_LIMIT
    node.note(7)
    assert node.alive_since == 7
