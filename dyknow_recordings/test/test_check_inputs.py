"""The configuration of a check."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pytest
from running_checks import run_check

from dyknow_common import SECOND_NS
from dyknow_configuration import RobotConfiguration
from dyknow_recordings.check_inputs import add_input_options, read_configuration
from dyknow_recordings.errors import RecordingError
from dyknow_stream_processing import Dataflow


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


def test_candidates_are_tried_one_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dataflow of as many streams as a robot.yaml has objects would take minutes to make."""
    features = [f'F{each}: {{from: {{topic: /trace, field: c{each}}}}}' for each in range(20)]
    robot = tmp_path / 'robot.yaml'
    robot.write_text('\n  '.join(['features:', *features]) + '\n')
    trace = tmp_path / 'trace.csv'
    trace.write_text(','.join(['time_s', *(f'c{each}' for each in range(20))]) + '\n0' + ',1' * 20)
    sizes: list[int] = []
    create = Dataflow.create

    def counted(self: Dataflow, *arguments: Any, **named: Any) -> None:
        create(self, *arguments, **named)
        sizes.append(len(self.names()))

    monkeypatch.setattr(Dataflow, 'create', counted)
    formula = ' and '.join(f'F{each} = 1' for each in range(20))
    assert run_check(trace, '--config', robot, '--formula', formula, '--json').code == 0
    assert len(sizes) > 20
    assert max(sizes) <= 2
