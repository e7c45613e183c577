"""State streams whose evaluations end while the streams are being replaced."""

from __future__ import annotations

import asyncio
from unittest.mock import MagicMock

import pytest

from dyknow_common import ExitCode, StreamConstraints
from dyknow_coordinator import CoordinationError
from dyknow_coordinator.ros.evaluation.state_stream import StateStream


def test_a_stream_that_was_destroyed_before_its_creation_is_not_created() -> None:
    """Otherwise nobody would destroy it: the formula was decided by a state of the former one."""
    context = MagicMock()
    stream = StateStream(context, 'states_2', MagicMock(), MagicMock())
    stream.destroy()
    with pytest.raises(CoordinationError, match='is not needed any more') as caught:
        asyncio.run(stream.create('select data from "/a"', StreamConstraints()))
    assert caught.value.code is ExitCode.CANCELLED
    context.cleanup.keep_stream.assert_not_called()
    context.clients.create_stream.assert_not_called()
