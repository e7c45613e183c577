"""Memory and samples of an engine and a manager under load for minutes.

python benchmarks/soak_streams.py [--minutes 10] [--json]
"""

from __future__ import annotations

import argparse
import time
from contextlib import suppress
from itertools import count
from typing import Any

from dyknow_interfaces.srv import StreamDestroy
from parts import print_report
from processes import (
    ENGINE,
    MANAGER,
    Client,
    growth_per_minute,
    nodes,
    processor_time,
    resident_memory,
    result_of,
    use_private_domain,
    worker,
)
from stream_counts import StreamCounts
from workers import FIELDS

TOPICS = 10
RATE = 50.0
JITTER_MS = 60.0
"""Maximum delay of messages after their stamps."""

LASTING = {
    # Half of the samples are late; no sample is late; samples out of order are dropped.
    'punctual': ' with max_delay = 30 ms',
    'patient': ' with max_delay = 5 s',
    'plain': '',
}
TEMPORARY = (
    'stream a = select pose.pose.position.x as x from "/odometry0" with max_delay = 100 ms; '
    'stream b = select pose.pose.position.y as y from "/odometry1" with max_delay = 100 ms; '
    'stream s = sync(a, b) with sample_period = 20 ms, sample_period_deviation = 0 ms; sink s'
)
MAX_TEMPORARY = 5
"""Maximum number of temporary streams."""

MAX_GROWTH = 0.25
"""Maximum growth of memory, MB per minute."""

WARM_UP = 0.4
"""The fraction of the run in which the bounded histories of violations fill up."""


class Churn:
    """Temporary streams; the oldest are destroyed."""

    def __init__(self, client: Client) -> None:
        self.created = 0
        self._client = client
        self._alive: list[str] = []
        self._numbers = count()

    def step(self) -> None:
        """Create a stream, and destroy the oldest one if there are many."""
        name = f'temporary{next(self._numbers)}'
        self._client.create(name, TEMPORARY, MANAGER)
        self.created += 1
        self._alive.append(name)
        if len(self._alive) > MAX_TEMPORARY:
            service = f'{MANAGER}/stream_destroy'
            answer = self._client.call(StreamDestroy, service, stream_name=self._alive.pop(0))
            assert not answer.exit_status.code, answer.exit_status.message


def soak(minutes: float) -> dict[str, Any]:
    """Run the load; return the growth of memory and the counts of samples."""
    memory: dict[str, list[tuple[float, float]]] = {ENGINE: [], MANAGER: []}
    messages = round(minutes * 60 * RATE)
    with nodes(ENGINE, MANAGER) as (client, processes):
        stream_counts, churn = StreamCounts(client), Churn(client)
        _create_lasting(client)
        arguments = ('--number', TOPICS, '--rate', RATE, '--jitter', JITTER_MS)
        begun = time.monotonic()
        with worker('publish', *arguments, '--messages', messages) as publisher:
            while publisher.poll() is None:
                churn.step()
                client.wait(0.5)
                for name, found in memory.items():
                    found.append((time.monotonic() - begun, resident_memory(processes[name])))
            assert result_of(publisher)['sent'] == messages * TOPICS
        lost = _lost(client, stream_counts, messages)
        share = processor_time(processes[ENGINE]) / (time.monotonic() - begun)
    growth = {name: growth_per_minute(found, WARM_UP) for name, found in memory.items()}
    return {
        'minutes': minutes,
        'messages': messages * TOPICS,
        'streams_created': churn.created,
        'samples_out': stream_counts.samples,
        'dropped': stream_counts.dropped,
        'samples_lost': lost,
        'engine_processor_share': round(share, 2),
        'memory_mb': {name: [found[0][1], found[-1][1]] for name, found in memory.items()},
        'growth_mb_per_minute': growth,
        'flat': all(each < MAX_GROWTH for each in growth.values()),
    }


def _create_lasting(client: Client) -> None:
    def made() -> bool:
        try:
            client.create('first', f'select {FIELDS} from "/odometry0"', MANAGER)
        except RuntimeError:
            return False
        return True

    client.spin_until(made, 'the manager has found the engine')
    for topic in range(TOPICS):
        for name, constraints in LASTING.items():
            text = f'select {FIELDS} from "/odometry{topic}"{constraints}'
            client.create(f'{name}{topic}', text, MANAGER)


def _lost(client: Client, stream_counts: StreamCounts, messages: int) -> int:
    """Return the number of samples that the lasting streams neither emitted nor dropped."""
    names = [f'{name}{topic}' for name in LASTING for topic in range(TOPICS)]

    def missing() -> int:
        return sum(messages - stream_counts.streams[name].total for name in names)

    with suppress(AssertionError):
        client.spin_until(lambda: bool(stream_counts.streams) and not missing(), 'all samples')
    return missing()


def main() -> None:
    """Run and print; the exit code is 1 if memory grows or samples are lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    use_private_domain()
    found = soak(arguments.minutes)
    print_report(found, as_json=arguments.json)
    raise SystemExit(not found['flat'] or found['samples_lost'] != 0)


if __name__ == '__main__':
    main()
