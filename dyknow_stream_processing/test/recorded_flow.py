"""A dataflow whose output is recorded, for tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from dyknow_common import NO_CONSTRAINTS, StreamConstraints, Value, ValueType
from dyknow_stream_processing import (
    Dataflow,
    Sample,
    SourceType,
    Unit,
    Violation,
    load_units,
    parse_specification,
)

MILLISECOND = 1_000_000


class Flow:
    """A dataflow that records what comes out; times are in milliseconds."""

    def __init__(
        self,
        units: Mapping[str, Unit] | None = None,
        max_lead: float = 100,
        remark: Callable[[Iterable[str]], str] = lambda _: '',
    ) -> None:
        self.receipt_topics: set[str] = set()
        self.sent_topics: set[str] = set()
        self.ordered_topics: set[str] = set()
        self.kept_topics: set[str] = set()
        self.types: dict[str, Mapping[str, ValueType]] = {}
        units = load_units() if units is None else units
        self.dataflow = Dataflow(units, self._source_type, _ns(max_lead), remark)
        self.samples: list[Sample] = []
        self.violations: list[Violation] = []

    def create(
        self, text: str, name: str = 's', constraints: StreamConstraints = NO_CONSTRAINTS
    ) -> Flow:
        self.dataflow.create(
            name,
            parse_specification(text),
            constraints,
            self.samples.append,
            self.violations.append,
        )
        return self

    def push(
        self,
        topic: str,
        valid_time: float,
        now: float | None = None,
        *,
        is_checked: bool = False,
        is_initial: bool = False,
        watermark: float | None = None,
        **fields: Value,
    ) -> None:
        available_time = valid_time if now is None else now
        promise = None if watermark is None else _ns(watermark)
        sample = Sample(_ns(valid_time), _ns(available_time), fields, promise)
        self.dataflow.push(topic, sample, is_checked=is_checked, is_initial=is_initial)

    def repeat(self, topic: str, valid_time: float, now: float, **fields: Value) -> None:
        self.dataflow.repeat(topic, Sample(_ns(valid_time), _ns(now), fields))

    def feed(self, topic: str, valid_times: Iterable[float]) -> None:
        for valid_time in valid_times:
            self.push(topic, valid_time, x=valid_time)

    def receive(self, topic: str, *arrivals: tuple[float, float]) -> None:
        """Push samples with their valid times and the times of their receipt."""
        for valid_time, now in arrivals:
            self.push(topic, valid_time, now, x=valid_time)

    def advance(self, now: float) -> None:
        self.dataflow.advance(_ns(now))

    @property
    def drops(self) -> dict[str, int]:
        return dict(self.dataflow.statistics('s').drops)

    @property
    def deadline(self) -> float | None:
        deadline = self.dataflow.next_deadline()
        return None if deadline is None else deadline / MILLISECOND

    def take(self) -> list[tuple[float, dict[str, Value]]]:
        """The samples since the last call: valid time and fields."""
        taken = [(each.valid_time / MILLISECOND, dict(each.fields)) for each in self.samples]
        self.samples.clear()
        return taken

    def times(self) -> list[float]:
        """The valid times of the samples since the last call."""
        return [time for time, _ in self.take()]

    def broken(self) -> list[tuple[str, float]]:
        """The violations since the last call: constraint and valid time."""
        taken = [(str(each.constraint), each.valid_time / MILLISECOND) for each in self.violations]
        self.violations.clear()
        return taken

    def _source_type(self, topic: str) -> SourceType | None:
        receipt_time, is_ordered = topic in self.receipt_topics, topic in self.ordered_topics
        is_sent = topic in self.sent_topics
        is_kept = topic in self.kept_topics
        if topic not in self.types and not (receipt_time or is_ordered or is_sent or is_kept):
            return None
        return SourceType(self.types.get(topic), receipt_time, is_ordered, is_sent, is_kept)


def _ns(milliseconds: float) -> int:
    return round(milliseconds * MILLISECOND)
