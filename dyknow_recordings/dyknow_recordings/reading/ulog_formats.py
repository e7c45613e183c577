"""Limits of the formats of messages in a log of PX4: pyulog makes a column for each value."""

from __future__ import annotations

from typing import Any, Final

from pyulog import ULog

from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.layouts import MAX_TEXT, MAX_VALUES

_MAX_NESTING: Final = 32


class BoundedLog(ULog):  # type: ignore[misc]
    """A log of PX4 whose formats have a limited size.

    MAX_VALUES bounds one message of each topic, together; MAX_TEXT the names of all.

    Raises:
        RecordingError: naming a format that is too large, or contains itself.
    """

    def __init__(self, file: Any) -> None:
        self._sizes: dict[str, tuple[int, int]] = {}
        self._values = self._text = 0
        super().__init__(file)

    def _MessageAddLogged(self, data: bytes, header: Any, formats: Any) -> Any:  # noqa: N802
        """Return a topic of the log, as pyulog reads it; it does not limit nested arrays."""
        name = ULog.parse_string(data[3:])
        values, text = self._size(name, formats, 0)
        self._values, self._text = self._values + values, self._text + text
        if values > MAX_VALUES:
            raise RecordingError(f"the format '{name[:80]}' has more than {MAX_VALUES} values")
        if self._values > MAX_VALUES:
            raise RecordingError(f'the messages of all topics have more than {MAX_VALUES} values')
        if self._text > MAX_TEXT:
            raise RecordingError(f"the names of values in the format '{name[:80]}' are too long")
        return ULog._MessageAddLogged(data, header, formats)  # noqa: SLF001 - overridden here

    def _size(self, name: str, formats: Any, depth: int) -> tuple[int, int]:
        """Return the number of values of a format, and of the characters of their names."""
        if depth > _MAX_NESTING:
            raise RecordingError(
                f"the format '{name[:80]}' contains itself, or is nested too deeply"
            )
        if name not in self._sizes:
            values = text = 0
            for kind, count, field in formats[name].fields:
                each, inner = (1, 0)
                if kind not in ULog._UNPACK_TYPES:  # noqa: SLF001
                    each, inner = self._size(kind, formats, depth + 1)
                repeats = max(count, 1)
                values += repeats * each
                text += repeats * (inner + each * (len(field) + len(str(repeats)) + 3))
            self._sizes[name] = values, text
        return self._sizes[name]
