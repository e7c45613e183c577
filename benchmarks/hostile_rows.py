"""The rows of hostile clients: each is one kind of harmful request or message."""

from __future__ import annotations

import hostile_messages
import hostile_semantics
import hostile_streams

ROWS = {
    each.__name__: each
    for each in (*hostile_messages.ROWS, *hostile_semantics.ROWS, *hostile_streams.ROWS)
}
"""All rows, by name."""
