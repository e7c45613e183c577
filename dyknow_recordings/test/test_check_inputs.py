"""The configuration of a check."""

from __future__ import annotations

import argparse
from typing import Any

import pytest

from dyknow_common import SECOND_NS
from dyknow_configuration import RobotConfiguration
from dyknow_recordings.check_inputs import add_input_options, read_configuration
from dyknow_recordings.errors import RecordingError


def silence_limit(parameters: dict[str, Any]) -> int:
    parser = argparse.ArgumentParser()
    add_input_options(parser)
    options = parser.parse_args(['bag', '--formula', 'always p'])
    robot = RobotConfiguration(parameters={'stream_reasoning_coordinator': parameters})
    return read_configuration(options, robot)[0].silence_limit


def test_the_silence_limit_is_that_of_the_coordinator() -> None:
    assert silence_limit({}) == 5 * SECOND_NS
    assert silence_limit({'silence_limit': 0.5}) == SECOND_NS // 2


@pytest.mark.parametrize('limit', ['long', 0.0, True])
def test_a_silence_limit_that_the_coordinator_refuses(limit: Any) -> None:
    with pytest.raises(RecordingError, match=r'silence_limit: .* no number of seconds from 0\.1'):
        silence_limit({'silence_limit': limit})


def test_a_file_without_formulas_is_named() -> None:
    parser = argparse.ArgumentParser()
    add_input_options(parser)
    options = parser.parse_args(['bag', '--config', 'robot.yaml'])
    with pytest.raises(RecordingError, match=r'robot.yaml has no formulas; add one, or give'):
        read_configuration(options, RobotConfiguration())
