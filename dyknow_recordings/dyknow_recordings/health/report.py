"""The health of recordings as tables and as JSON.

The module is imported where it is asked for alone, as rich is slow to import.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

from rich.text import Text

from dyknow_common import date_time, round_duration, round_time
from dyknow_common.tables import ReportTable, Terminal, figure, folded, json_document, named
from dyknow_recordings.health.expectations import BrokenExpectation
from dyknow_recordings.health.measures import RecordingHealth, TopicHealth

_TIMES: Final = frozenset({
    'start', 'end', 'begin', 'gap', 'gap_begin', 'gap_end', 'offset', 'offset_spread', 'duration',
    'interval', 'least_interval', 'greatest_interval', 'jitter', 'delays', 'lead', 'silence',
})  # fmt: skip
"""The fields in nanoseconds."""


def health_document(health: RecordingHealth) -> dict[str, Any]:
    """Return the health of a recording as a line of JSON."""
    return {**json_document(health, _TIMES), 'error': None}


def print_health(health: RecordingHealth) -> None:
    """Print a table of the topics, and the expectations that are broken."""
    duration = round_duration(health.end - health.start)
    columns = [
        named('topic'),
        *map(figure, ('messages', 'rate', 'jitter', 'gap', 'at', 'delay', 'greatest')),
        folded('type and faults'),
    ]
    rows = [_row(each, health.start) for each in health.health]
    title = Text(f'{health.recording} ({duration} from {date_time(health.start)} on)')
    Terminal(highlight=False).print(title, ReportTable(columns, rows), sep='\n')
    print_broken(health.broken_expectations)
    sys.stdout.flush()


def print_broken(found: Iterable[BrokenExpectation]) -> None:
    """Print the expectations that a recording breaks."""
    for each in found:
        Terminal(highlight=False).print(Text(str(each), style='red'))


def _row(topic: TopicHealth, start: int) -> Sequence[str]:
    timing, text = topic.timing, '; '.join([topic.message_type, *_remarks(topic)])
    if timing is None or topic.gap is None or topic.gap_begin is None:
        return (topic.topic, str(topic.messages), *6 * ('',), text)
    jitter = '' if timing.interval is None else round_duration(timing.jitter)
    delays = () if timing.delays is None else (timing.delays[0], timing.delays[-1])
    return (
        topic.topic,
        str(topic.messages),
        '' if timing.rate is None else f'{timing.rate:.3g} Hz',
        jitter,
        round_duration(topic.gap),
        round_time(topic.gap_begin - start),
        *(map(round_duration, delays) if delays else ('', '')),
        text,
    )


def _remarks(topic: TopicHealth) -> Iterator[str]:
    if topic.timing is not None:
        numbers = {
            'without a stamp': topic.unstamped or 0,
            f'stamped ahead by up to {round_duration(topic.timing.lead)}': topic.stamped_ahead,
            'out of order': topic.timing.disorders,
            'missing by the sequence numbers': topic.missing,
        }
        yield from ('no stamp',) if topic.unstamped is None else ()
        yield from (f'{number} {text}' for text, number in numbers.items() if number)
    yield from topic.faults
    if topic.offset is not None and topic.offset_spread is not None:
        distance, spread = map(round_duration, (abs(topic.offset), topic.offset_spread))
        side = 'after' if topic.offset >= 0 else 'before'
        yield f'{distance} {side} {topic.offset_from}, give or take {spread}'
