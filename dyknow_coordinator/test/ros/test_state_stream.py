"""State streams whose evaluations end while the streams are being replaced."""

from __future__ import annotations

import asyncio
from typing import Any
from unittest.mock import AsyncMock, MagicMock

import pytest
from dyknow_interfaces.msg import ConstraintViolation

from dyknow_common import ExitCode, StreamConstraints
from dyknow_common.ros import nanoseconds_to_time
from dyknow_coordinator import CoordinationError, Grounding
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.state_specification import FormulaInputs
from dyknow_coordinator.ros.evaluation.standby import TakenStandby
from dyknow_coordinator.ros.evaluation.state_stream import StateStream
from dyknow_coordinator.ros.evaluation.state_supervisor import StateSupervisor
from dyknow_stream_processing import ViolationKind

POWER = 'Power[uav1]'


def test_a_stream_that_was_destroyed_before_its_creation_is_not_created() -> None:
    """Otherwise nobody would destroy it: the formula was decided by a state of the former one."""
    context = MagicMock()
    stream = StateStream(context, 'states_2', MagicMock(), MagicMock())
    stream.destroy()
    with pytest.raises(CoordinationError, match='is not needed any more') as caught:
        asyncio.run(stream.create((), StreamConstraints()))
    assert caught.value.code is ExitCode.CANCELLED
    context.cleanup.keep_stream.assert_not_called()
    context.clients.create_stream.assert_not_called()


def test_a_stream_that_is_not_needed_any_more_is_destroyed_after_its_creation() -> None:
    """A request to destroy it might overtake the one to create it, and find nothing."""
    context = MagicMock()
    stream = StateStream(context, 'states_2', MagicMock(), MagicMock())

    async def create(*_: object) -> tuple[str, str]:
        stream.destroy()
        context.cleanup.destroy_stream.assert_not_called()
        return 'states_2', 'states_2/violations'

    context.clients.create_stream = create
    asyncio.run(stream.create((), StreamConstraints()))
    context.cleanup.destroy_stream.assert_called_once_with('states_2')
    context.node.create_subscription.assert_not_called()


def test_a_better_stream_that_comes_with_the_verdict_is_not_used() -> None:
    """Nobody would destroy the states that are made of it."""
    context = MagicMock()
    context.wall_time.return_value = context.wall_time_s.return_value = 0
    context.clients.evaluate_group = AsyncMock()
    context.clients.create_stream = AsyncMock(return_value=('states_2', 'states_2/violations'))
    spawned: list[Any] = []
    context.node.spawn = spawned.append
    found = _candidates('b')
    inputs = FormulaInputs((), Grounding.AUTO, (POWER,), found, {}, StreamConstraints())
    supervisor = StateSupervisor(context, 7, 'states_1', inputs, MagicMock())
    supervisor.update_candidates(_candidates('a', 'b'))
    supervisor.end()
    (improve,) = spawned
    asyncio.run(improve())
    context.clients.create_stream.assert_not_called()


def test_a_take_over_tells_from_when_on_former_states_are_doubtful() -> None:
    context = MagicMock()
    context.wall_time.return_value = context.wall_time_s.return_value = 0
    context.clients.evaluate_group = AsyncMock()
    spawned: list[Any] = []
    context.node.spawn = spawned.append
    found = _candidates('a', 'b')
    inputs = FormulaInputs((), Grounding.AUTO, (POWER,), found, {}, StreamConstraints())
    supervisor = StateSupervisor(context, 7, 'states_1', inputs, MagicMock())
    standby = MagicMock(topic='/states_2')
    supervisor._standby = MagicMock()
    supervisor._standby.take.return_value = TakenStandby(standby, ())
    for valid_time in (6, 5, 7):
        violation = ConstraintViolation(constraint=ViolationKind.SOURCE, stream_name='a')
        violation.valid_time = nanoseconds_to_time(valid_time)
        supervisor._on_violation(supervisor.stream, violation)
    (recover,) = spawned
    asyncio.run(recover())
    ((_, kinds),) = context.clients.evaluate_group.call_args_list
    assert kinds == {'gap': True, 'doubtful_from': 5}


def _candidates(*streams: str) -> Candidates:
    return Candidates(
        tuple(FeatureSource(POWER, f'p_{each}', f'p_{each} = {each}') for each in streams)
    )
