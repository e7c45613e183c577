"""Why a stream has no samples: the topics and operators that its operators wait for.

Example: `sync("/a", (select x from "/b" where x > 9), "/c")`, of which only /b has delivered, with
x = 1. The `sync` waits for the two others; so the reasons are those of /a and of /c, such as
`nobody publishes /a`. Once these deliver, the `sync` waits for the `select`, whose input delivers
samples while it emits none. So the reason is its own: `no sample of /b satisfies x > 9`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from dyknow_stream_processing.dataflow.operators import Operator

_MAX_NAME: Final = 80
"""The length of a text that names an operator."""


def waiting_reasons(
    operator: Operator,
    since: int,
    topic_reason: Callable[[str], str],
    name_of: Callable[[str], str],
) -> Iterator[str]:
    """Yield why an operator emits no samples, if it emits none.

    Args:
        operator: is taken to emit none.
        since: samples before this time, nanoseconds, do not count.
        topic_reason: returns why a topic has no messages; empty if it needs none.
        name_of: returns the name of the stream that the label of an operator states.
    """

    def name(each: Operator) -> str:
        text = name_of(each.label)
        return text if len(text) <= _MAX_NAME else f'{text[:_MAX_NAME]}...'

    if not operator.inputs:
        if reason := topic_reason(operator.label):
            yield reason
        return
    silent = [each for each in operator.awaited() if not _delivers(each, operator, since)]
    for each in silent:
        yield from waiting_reasons(each, since, topic_reason, name_of)
    if not silent and (obstacle := operator.obstacle(name)):
        yield obstacle


def _delivers(source: Operator, consumer: Operator, since: int) -> bool:
    """Return True if an operator has emitted a sample since then, and after the consumer's last."""
    if source.emitted_at is None or source.emitted_at <= since:
        return False
    return consumer.emitted_at is None or source.emitted_at > consumer.emitted_at
