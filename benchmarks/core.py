"""Cost of the operators without ROS, in microseconds for each input sample."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing import Dataflow, Sample, load_units, parse_specification

PERIOD_NS = 10_000_000
REPETITIONS = 5

Input = tuple[str, Sample]
Rows = list[tuple[int, dict[str, object]]]


def core_rows(samples: int) -> list[dict[str, object]]:
    """Return the costs of select, merge and sync, and of a reference with the same result."""
    select = 'select x as a, y as b from "/t0" where x >= 0'
    rows = [
        _row('select', select, _inputs(1, samples), _reference_select),
        _row('merge', 'merge("/t0", "/t1")', _inputs(2, samples), _reference_merge),
    ]
    return rows + [
        _row(f'sync of {number}', _sync_text(number), _states(number, samples), _reference_sync)
        for number in (2, 4, 8, 16, 32, 64, 128, 256)
    ]


def _sync_text(number: int) -> str:
    topics = ', '.join(f'"/t{topic}"' for topic in range(number))
    return f'sync({topics})'


def _inputs(number: int, samples: int) -> list[Input]:
    """Return about so many samples, of topics with the same rate."""
    return [
        (f'/t{topic}', Sample(tick * PERIOD_NS, tick * PERIOD_NS + topic, {'x': tick, 'y': 0.5}))
        for tick in range(1, 1 + samples // number)
        for topic in range(number)
    ]


def _states(number: int, samples: int) -> list[Input]:
    """Return the same samples; each topic has a field of its own."""
    return [
        (topic, Sample(sample.valid_time, sample.available_time, {topic: sample.fields['x']}))
        for topic, sample in _inputs(number, samples)
    ]


def _row(
    work: str, text: str, inputs: Sequence[Input], reference: Callable[[Sequence[Input]], Rows]
) -> dict[str, object]:
    made: list[Sample] = []
    _run(text, inputs, made.append)
    rows = [(each.valid_time, dict(each.fields)) for each in made]
    assert rows == reference(inputs), f'{work}: differs from the reference'
    times = [_run(text, inputs, lambda _: None) for _ in range(REPETITIONS)]
    baseline = []
    for _ in range(REPETITIONS):
        begun = time.process_time()
        reference(inputs)
        baseline.append(time.process_time() - begun)
    return {
        'work': work,
        'us_per_input': round(statistics.median(times) / len(inputs) * 1e6, 2),
        'reference_us_per_input': round(statistics.median(baseline) / len(inputs) * 1e6, 2),
    }


def _run(text: str, inputs: Sequence[Input], on_sample: Callable[[Sample], None]) -> float:
    flow = Dataflow(load_units(), lambda _: None)
    flow.create('s', parse_specification(text), NO_CONSTRAINTS, on_sample, lambda _: None)
    push, next_deadline = flow.push, flow.next_deadline
    begun = time.process_time()
    for topic, sample in inputs:
        push(topic, sample)
        next_deadline()
    return time.process_time() - begun


def _reference_select(inputs: Sequence[Input]) -> Rows:
    return [
        (sample.valid_time, {'a': sample.fields['x'], 'b': sample.fields['y']})
        for _, sample in inputs
        if float(sample.fields['x']) >= 0
    ]


def _reference_merge(inputs: Sequence[Input]) -> Rows:
    return [(sample.valid_time, dict(sample.fields)) for _, sample in inputs]


def _reference_sync(inputs: Sequence[Input]) -> Rows:
    """Combine the samples of each tick; all topics have the same rate."""
    states: dict[int, dict[str, object]] = {}
    for topic, sample in inputs:
        state = states.setdefault(sample.valid_time, {})
        state[topic] = sample.fields[topic]
    return list(states.items())
