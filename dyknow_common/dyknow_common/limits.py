"""Limits of the texts of all languages."""

from __future__ import annotations

from typing import Final

MAX_CHARACTERS: Final = 1_000_000
"""The length of a text."""

MAX_WORDS: Final = 200_000
"""The number of words and symbols in a text, which bounds the time to parse it."""

MAX_STREAM_PARTS: Final = 200_000
"""The number of parts of the streams of a text, each with all streams that it is made of."""

MAX_FORMULA_PARTS: Final = 1_000_000
"""The number of parts of a formula for all objects that its variables range over."""

MAX_DEPTH: Final = 100
"""The depth to which a text nests, and so to which functions may recurse over its syntax."""
