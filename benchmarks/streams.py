"""Cost of streams in the core, in a node and in an engine, with baselines in the same run.

python benchmarks/streams.py [--json] [--only core|figure_6|relay|load] [--quick]
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

from parts import measure, processor_times
from processes import (
    SampleCounts,
    engine,
    processor_time,
    ratios,
    result_of,
    summary,
    use_private_domain,
    wait_until_begun,
    worker,
)
from workers import FIELDS

from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing import Dataflow, Sample, load_units, parse_specification

RELAY_STREAM = (
    'stream position = select pose.pose.position.x as x, pose.pose.position.y as y '
    'from "/odometry0"; stream speed = select twist.twist.linear.x as speed from "/odometry0"; '
    'stream relayed = sync(position, speed); sink relayed'
)
TOPICS = 50
STREAMS = 200
LOAD_RATE = 20.0
PERIOD_NS = 10_000_000
REPETITIONS = 5

Input = tuple[str, Sample]
Rows = list[tuple[int, dict[str, object]]]


def core(*, quick: bool) -> Any:
    """Measure the operators without ROS, beside references with the same result."""
    samples = 5_000 if quick else 50_000
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
    baseline = processor_times(lambda: reference(inputs), REPETITIONS)
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


def figure_6(*, quick: bool) -> Any:
    """Measure the delays of n StreamProxies, and of n bare subscriptions, to a topic at 100 Hz."""
    seconds, repetitions = (2.0, 1) if quick else (4.0, 3)
    rows: list[dict[str, Any]] = []
    with worker('publish', '--rate', 100):
        for number in (1, 2, 4, 8, 16, 32):
            delays: dict[str, list[int]] = {'proxy': [], 'bare': []}
            for kind in [*delays] * repetitions:
                with worker(kind, '--number', number, '--seconds', seconds) as process:
                    delays[kind] += result_of(process)['delays']
            found = {kind: summary(each) for kind, each in delays.items()}
            compared = ratios(found['proxy'], found['bare'])
            rows.append({'subscriptions': number, **found, **compared})
    return rows


def relay(*, quick: bool) -> Any:
    """Measure the delay from a source to a sink through an engine and through a bare relay node."""
    seconds, repetitions = (3.0, 1) if quick else (6.0, 4)
    delays: dict[str, list[int]] = {'engine': [], 'bare': [], 'direct': []}
    used: dict[str, float] = {'engine': 0.0, 'bare': 0.0}
    with worker('publish', '--rate', 100):
        for _ in range(repetitions):
            with engine() as (client, process_id):
                topic = client.create('relayed', RELAY_STREAM)
                used['engine'] += _sink(topic, seconds, process_id, delays['engine'])
            with worker('relay') as process:
                used['bare'] += _sink('/relayed', seconds, process.pid, delays['bare'])
            with worker('bare', '--seconds', seconds) as process:
                delays['direct'] += result_of(process)['delays']
    found: dict[str, Any] = {kind: summary(each) for kind, each in delays.items()}
    for kind, time_used in used.items():
        found[kind]['processor_us'] = round(time_used / len(delays[kind]) * 1e6)
        found[kind]['added_us'] = round(found[kind]['median_us'] - found['direct']['median_us'], 1)
    ratio = round(found['engine']['added_us'] / found['bare']['added_us'], 2)
    return {**found, 'added_median_ratio': ratio}


def _sink(topic: str, seconds: float, relay_process: int, delays: list[int]) -> float:
    """Add the delays of a topic; return the processor time of the relay."""
    with worker('sink', '--topic', topic, '--seconds', seconds) as process:
        # The start of the relay costs more than its work.
        wait_until_begun(process)
        begun = processor_time(relay_process)
        delays += result_of(process)['delays']
        return processor_time(relay_process) - begun


def load(*, quick: bool) -> Any:
    """Measure an engine with 200 streams over 50 topics at 20 Hz."""
    messages = 100 if quick else 400
    with engine() as (client, process_id):
        counts = SampleCounts(client)
        for number in range(STREAMS):
            client.create(f's{number}', f'select {FIELDS} from "/odometry{number % TOPICS}"')
        arguments = ('--number', TOPICS, '--rate', LOAD_RATE, '--messages', messages)
        seconds = messages / LOAD_RATE
        with (
            worker('matched', '--number', STREAMS) as matched,
            worker('sink', '--topic', '/dyknow/streams/s0', '--seconds', seconds - 2) as sink,
        ):
            wait_until_begun(matched)
            begun = processor_time(process_id)
            with worker('publish', *arguments) as publisher:
                sent = result_of(publisher)['sent']
            expected = sent * STREAMS // TOPICS
            client.spin_until(lambda: counts.received() >= expected, f'{expected} samples')
            used = processor_time(process_id) - begun
            delays = result_of(sink)['delays']
        return {
            'messages': sent,
            'samples_expected': expected,
            'samples_out': sum(counts.emitted.values()),
            'dropped': sum(counts.dropped.values()),
            'engine_processor_share': round(used / seconds, 2),
            'delay': summary(delays),
        }


if __name__ == '__main__':
    use_private_domain()
    measure(__doc__, core, figure_6, relay, load)
