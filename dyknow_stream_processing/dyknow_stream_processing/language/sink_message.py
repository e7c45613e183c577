"""Publications of a stream as messages of some type, `as std_msgs/msg/Float64 on "/altitude"`."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import SyntaxNode, Value, quoted


@dataclass(frozen=True, slots=True)
class Assignment(SyntaxNode):
    """The value of a field of the messages, `point.x = east` or `header.frame_id = "map"`.

    Args:
        path: of the field in a message.
        field: of the stream; empty for a constant.
        constant: the value; `None` for a field of the stream.
    """

    path: str
    field: str = ''
    constant: Value | None = None

    def __str__(self) -> str:
        value = quoted(self.constant) if isinstance(self.constant, str) else repr(self.constant)
        return f'{self.path} = {self.field or value}'


@dataclass(frozen=True, slots=True)
class SinkMessage(SyntaxNode):
    """The messages as which a stream is published too.

    Args:
        message_type: such as `std_msgs/msg/Float64`.
        assignments: empty: the fields of the stream have the names of those of the message, or
            there is one field in both.
        topic: empty: the topic of the stream, and `/message`.
    """

    message_type: str
    assignments: tuple[Assignment, ...] = ()
    topic: str = ''

    def __str__(self) -> str:
        assigned = f' ({", ".join(map(str, self.assignments))})' if self.assignments else ''
        topic = f' on {quoted(self.topic)}' if self.topic else ''
        return f'as {self.message_type}{assigned}{topic}'
