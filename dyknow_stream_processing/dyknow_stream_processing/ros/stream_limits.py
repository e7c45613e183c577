"""Limits of the streams of a node, and of the time that a request takes from others."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Any, Final

from dyknow_common import ExitCode, round_duration
from dyknow_common.ros import Background, DyKnowNode
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import LONG_TEXT, parse_specification
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.reporting.silence import MAX_LAG_NS

MAX_CHARACTERS: Final = 4_000_000
"""The characters of the specifications of all streams."""


class StreamLimits:
    """The parameters `max_streams` and `max_specification` of a node.

    Args:
        max_streams: the default.
    """

    def __init__(self, node: DyKnowNode, max_streams: int) -> None:
        self._name = node.get_fully_qualified_name()
        self._streams = node.changing_parameter(
            'max_streams', max_streams, 'Number of streams at once.', (1, 1_000_000)
        )
        self._characters = node.changing_parameter(
            'max_specification',
            500_000,
            'Number of characters of the specification in a request.',
            (100, 1_000_000),
        )

    def check(self, texts: Collection[str], spec: Any = None, lag: int = 0) -> None:
        """Check that another stream is possible.

        Args:
            texts: the specifications of the streams that the node has.
            spec: the StreamSpec message, if there is one.
            lag: how long the oldest message has waited, in nanoseconds.

        Raises:
            StreamError: UNAVAILABLE with too many streams, or for a node that cannot keep up;
                INVALID_ARGUMENT for a long text.
        """
        characters = sum(map(len, texts))
        if characters > MAX_CHARACTERS:
            raise StreamError(
                f'the specifications of the streams of {self._name} have {characters} characters, '
                f'more than {MAX_CHARACTERS}; destroy unused streams first',
                ExitCode.UNAVAILABLE,
            )
        if lag > MAX_LAG_NS:
            raise StreamError(
                f'{self._name} cannot keep up: a message has waited for {round_duration(lag)}; '
                'destroy streams that are not needed, or start another engine',
                ExitCode.UNAVAILABLE,
            )
        most = self._streams()
        if len(texts) >= most:
            raise StreamError(
                f'{self._name} has {len(texts)} streams, and its parameter max_streams allows '
                f'{most}; destroy unused ones first',
                ExitCode.UNAVAILABLE,
            )
        length = 0 if spec is None else len(spec.specification)
        longest = self._characters()
        if length > longest:
            raise StreamError(
                f'the specification has {length} characters, and the parameter max_specification '
                f'of {self._name} allows {longest}; make the stream of several streams'
            )


async def parse_beside(background: Background, text: str) -> Specification:
    """Parse a specification; one that is long in the background."""
    return await background.run(partial(parse_specification, text), is_long=len(text) > LONG_TEXT)
