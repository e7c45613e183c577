"""The length of the texts that clients send to the semantic nodes.

Texts are parsed in the thread of the node: it takes 1 s for 100,000 words.
"""

from __future__ import annotations

from dyknow_common.ros import DyKnowNode
from dyknow_semantics.errors import SemanticsError


def max_characters(node: DyKnowNode) -> int:
    """Return the number of characters that a text may have, a parameter of the node."""
    return int(
        node.parameter(
            'max_characters', 20_000, 'Characters of a text in a request.', (100, 1_000_000)
        )
    )


def check_length(kind: str, text: str, most: int) -> None:
    """Check the length of a text.

    Raises:
        SemanticsError: if it is too long.
    """
    if len(text) > most:
        raise SemanticsError(
            f'the {kind} has {len(text):,} characters, more than {most:,}; split it, or increase '
            'max_characters'
        )
