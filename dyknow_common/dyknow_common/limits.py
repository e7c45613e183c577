"""Size limits for source texts and for their caches."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from threading import Lock
from typing import Any, Concatenate, Final, ParamSpec, TypeVar

MAX_CHARACTERS: Final = 1_000_000
"""The length of a text."""

MAX_FILE_BYTES: Final = 16 * 1024 * 1024
"""The size of a file that is read as a whole: a recording is not."""

MAX_WORDS: Final = 200_000
"""The number of words and symbols in a text, which bounds the time to parse it."""

MAX_STREAM_PARTS: Final = 200_000
"""The number of parts of the streams of a text, each with all streams that it is made of."""

MAX_FORMULA_PARTS: Final = 1_000_000
"""The number of parts of a formula for all objects that its variables range over."""

MAX_DEPTH: Final = 100
"""The depth to which a text nests, and so to which functions may recurse over its syntax."""

MAX_TOPIC_LENGTH: Final = 247
"""The number of characters in the absolute name of a topic: 255 in DDS, without prefixes of ROS."""

MAX_NAME: Final = 1000
"""The length of the name of a formula, a group, an evaluation, a plan, a concept or an object."""

MAX_CACHED_CHARACTERS: Final = 5_000_000
"""The length of all texts of a cache; a syntax tree takes some 15 bytes for each character."""

ENTRY_CHARACTERS: Final = 50
"""The length that an entry of a cache counts in addition to its text, for short texts."""

Others = ParamSpec('Others')
Result = TypeVar('Result')


def check_name(name: str, error: Callable[[str], Exception], field: str = 'the name') -> None:
    """Check the length of a name.

    Args:
        name: in a request.
        error: makes the error.
        field: names it.

    Raises:
        Exception: if it is too long.
    """
    if len(name) > MAX_NAME:
        raise error(f'{field} has {len(name)} characters, more than {MAX_NAME}; shorten it')


def cached_by_text(
    function: Callable[Concatenate[str, Others], Result],
) -> Callable[Concatenate[str, Others], Result]:
    """Return a function that keeps the results for the texts that were used last.

    Args:
        function: its first argument is a text, and all can be hashed. Errors are not kept.
    """
    known: OrderedDict[Any, Result] = OrderedDict()
    lock = Lock()
    total = 0

    @wraps(function)
    def cached(text: str, /, *others: Others.args, **named: Others.kwargs) -> Result:
        nonlocal total
        key = text, others, tuple(named.items())
        with lock:
            if key in known:
                known.move_to_end(key)
                return known[key]
        result = function(text, *others, **named)
        with lock:
            total += 0 if key in known else len(text) + ENTRY_CHARACTERS
            known[key] = result
            while total > MAX_CACHED_CHARACTERS:
                (oldest, *_), _ = known.popitem(last=False)
                total -= len(oldest) + ENTRY_CHARACTERS
        return result

    return cached
