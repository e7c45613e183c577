"""Two hosts with clocks and ROS domains of their own, joined by zenoh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import ListSemanticSpecifications

from federations import BASE, CARRIER, Host, free_port, wait_for


class Fleet(NamedTuple):
    base: Host
    carrier: Host


@pytest.fixture(scope='module')
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp('fleet')
    end = f'tcp/127.0.0.1:{free_port()}'
    base = Host(folder / 'base', BASE.format(ends=f'listen: {end}'))
    carrier = Host(folder / 'carrier1', CARRIER.format(name='carrier1', ends=f'connect: {end}'))
    carrier.publish_battery('carrier1')
    with ExitStack() as stack:
        for each in (base, carrier):
            stack.enter_context(each)
        yield Fleet(base, carrier)


def wait_for_streams(fleet: Fleet, number: int) -> None:
    """Wait until the base knows this number of streams of peers."""
    service = '/stream_semantics_manager/list_semantic_specifications'
    asked = fleet.base.client.request(ListSemanticSpecifications, service)

    def are_known() -> bool:
        nonlocal asked
        if not asked.done():
            return False
        if len(asked.result().ssl_statements) == number:
            return True
        asked = fleet.base.client.request(ListSemanticSpecifications, service)
        return False

    wait_for(*fleet, until=are_known, what=f'{number} streams of peers')


def test_a_formula_is_about_another_host(fleet: Fleet) -> None:
    wait_for_streams(fleet, 1)
    asked = fleet.base.ask('forall c in Carrier: always[0 s, 1 s] Charge[c] > 0.5')
    wait_for(*fleet, until=asked.done, what='the answer')
    answer = asked.result()
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer
    assert answer.verdict == FormulaResult.TRUE, answer
