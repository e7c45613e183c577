"""The load of a soak on streams: late messages, and streams that are created and destroyed."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from itertools import count
from typing import Any

from dyknow_interfaces.srv import StreamDestroy
from processes import MANAGER, SampleCounts, result_of, worker
from running_system import RunningSystem
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
PERIOD_S = 0.5
"""Time between two temporary streams."""

MAX_TEMPORARY = 5
"""Maximum number of temporary streams."""


class StreamLoad:
    """Messages, lasting streams, and temporary ones, the oldest of which are destroyed."""

    def __init__(self, system: RunningSystem, seconds: float, stack: ExitStack) -> None:
        self._messages = round(seconds * RATE)
        self._client = system.client
        self._counts = SampleCounts(system.client)
        self._numbers = count()
        self._next = 0.0
        self._alive: list[str] = []
        for topic in range(TOPICS):
            for name, constraints in LASTING.items():
                text = f'select {FIELDS} from "/odometry{topic}"{constraints}'
                self._client.create(f'{name}{topic}', text, MANAGER)
        arguments = ('--number', TOPICS, '--rate', RATE, '--jitter', JITTER_MS)
        self._publisher = stack.enter_context(
            worker('publish', *arguments, '--messages', self._messages)
        )

    def step(self) -> None:
        """Create a temporary stream if one is due, and destroy the oldest one if there are many."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + PERIOD_S
        self._alive.append(f'temporary{next(self._numbers)}')
        self._client.create(self._alive[-1], TEMPORARY, MANAGER)
        if len(self._alive) > MAX_TEMPORARY:
            service = f'{MANAGER}/stream_destroy'
            answer = self._client.call(StreamDestroy, service, stream_name=self._alive.pop(0))
            assert not answer.exit_status.code, answer.exit_status.message

    def report(self) -> dict[str, Any]:
        """Wait for all samples, and return the counts; `lost` are neither emitted nor dropped."""
        assert result_of(self._publisher)['sent'] == self._messages * TOPICS
        names = [f'{name}{topic}' for name in LASTING for topic in range(TOPICS)]

        def counted() -> list[int]:
            found = (self._counts.emitted, self._counts.dropped)
            return [sum(each.get(name, 0) for name in names) for each in found]

        expected = self._messages * len(names)
        with suppress(AssertionError):
            self._client.spin_until(lambda: sum(counted()) == expected, 'all samples')
        emitted, dropped = counted()
        return {
            'messages': self._messages * TOPICS,
            'streams_created': next(self._numbers),
            'samples_out': emitted,
            'dropped': dropped,
            'samples_lost': expected - emitted - dropped,
        }
