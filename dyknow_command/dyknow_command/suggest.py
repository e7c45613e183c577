"""The verb `suggest`: measure a topic, and print the timing constraints that it keeps."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dyknow_command.observing import absolute_topic, add_duration_option, observe
from dyknow_common import DyKnowError, ExitCode, round_duration, visible
from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import (
    ObservedTopic,
    ProposedTiming,
    TopicTiming,
    proposed_timing,
    timing_of,
)
from dyknow_recordings import add_reading_options, message_types, observe_recording


def suggest(options: argparse.Namespace) -> int:
    """Print the timing of a topic, and return the exit code."""
    name = absolute_topic(options.topic)
    if options.recording is None:
        found = observe(options.duration, lambda *_: (), name)
    else:
        found = observe_recording(options.recording, message_types(options), lambda *_: (), name)
    topic = next((each for each in found if each.count), None)
    if topic is None:
        where = options.recording or f'{round_duration(options.duration)}; is it published?'
        raise DyKnowError(f'no message of {name} in {where}', ExitCode.UNAVAILABLE)
    timing, proposed = timing_of(topic.times), proposed_timing([topic.times])
    if options.json:
        print(json.dumps(_document(topic, timing, proposed)))  # noqa: T201 - this is a command
    else:
        print(visible('\n'.join(_lines(topic, timing, proposed))))  # noqa: T201
    return SUCCESS


def add_suggest_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=suggest)
    describe(
        parser,
        'Measure a topic of the running robot or of a recording, and print the timing constraints '
        'that it keeps, with a margin of half of what was measured. No node of DyKnow has to run.',
        (
            'dyknow suggest /rover1/odom',
            'dyknow suggest /rover1/odom --duration 60',
            'dyknow suggest /rover1/odom flight.mcap --json',
        ),
        '0 if the topic was measured, 2 if it had no message, or for another error',
    )
    parser.add_argument('topic', help='the name of the topic')
    parser.add_argument(
        'recording', nargs='?', type=Path, help='a recording, in the place of the running robot'
    )
    add_duration_option(parser)
    add_reading_options(parser)
    parser.add_argument('--json', action='store_true', help='print a line of JSON')


def _lines(topic: ObservedTopic, timing: TopicTiming, proposed: ProposedTiming) -> Iterator[str]:
    messages = f'{timing.count} message{"s" * (timing.count != 1)}'
    yield f'{topic.name} ({topic.message_type}): {messages}'
    if timing.rate is not None and timing.interval is not None:
        median, least, greatest, jitter = map(
            round_duration,
            (timing.interval, timing.least_interval, timing.greatest_interval, timing.jitter),
        )
        yield f'  rate      {timing.rate:.4g} Hz'
        yield f'  interval  median {median}, least {least}, greatest {greatest}, jitter {jitter}'
    if timing.delays is None:
        yield '  delay     unknown: the messages have no stamp'
    else:
        median, most, nearly_all, greatest = map(round_duration, timing.delays)
        yield f'  delay     median {median}, 95 % {most}, 99 % {nearly_all}, greatest {greatest}'
    if timing.disorders:
        yield f'  order     {timing.disorders} with a stamp before that of an earlier message'
    yield from (f'  note      {remark}' for remark in proposed.remarks)
    if given := proposed.constraints.texts():
        yield ''
        yield 'In streams and SSL:'
        yield f'    with {proposed.constraints}'
        yield 'In robot.yaml, beside topic:'
        yield from (f'    {name}: {text}' for name, text in given.items())


def _document(
    topic: ObservedTopic, timing: TopicTiming, proposed: ProposedTiming
) -> dict[str, Any]:
    delays = timing.delays or (None,) * 4
    return {
        'topic': topic.name,
        'message_type': topic.message_type,
        'messages': timing.count,
        'rate': timing.rate,
        'interval_ns': timing.interval,
        'least_interval_ns': timing.least_interval,
        'greatest_interval_ns': timing.greatest_interval,
        'jitter_ns': timing.jitter,
        'delay_ns': dict(zip(('median', '95', '99', 'greatest'), delays, strict=True)),
        'lead_ns': timing.lead,
        'disorders': timing.disorders,
        'constraints_ns': proposed.constraints.given(),
        'remarks': list(proposed.remarks),
    }
