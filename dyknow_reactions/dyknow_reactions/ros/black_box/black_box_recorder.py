"""Record the messages around the moment when a formula fails, as bags of rosbag2.

ros2 run dyknow_reactions black_box_recorder --ros-args -p folder:=/data/black_boxes
"""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, Self

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import BlackBoxReport, EvaluationStatusArray, Sample
from dyknow_interfaces.srv import SaveBlackBox
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.task import Future

from dyknow_common import (
    DyKnowError,
    ExitCode,
    clock_time,
    listed,
    read_text,
    round_duration,
    with_readable_times,
)
from dyknow_common.ros import (
    DiagnosticsPublisher,
    DyKnowNode,
    nanoseconds_to_time,
    run,
    time_to_nanoseconds,
)
from dyknow_coordinator import EvaluationStatus, verdict_token
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from dyknow_reactions.black_box.box_content import (
    RecordedStateNumber,
    content_of,
)
from dyknow_reactions.black_box.box_folder import BoxFolder
from dyknow_reactions.black_box.failures import FailureWatch, FormulaKey, OpenBox
from dyknow_reactions.black_box.message_ring import MessageRing, SerialisedMessage
from dyknow_reactions.ros.black_box.box_writing import BoxWriting, SnapshotService, WriteBox
from dyknow_reactions.ros.black_box.formula_origins import FormulaOrigins
from dyknow_reactions.ros.black_box.raw_topics import RawTopics
from dyknow_recordings import horizon
from dyknow_stream_processing.ros import PAUSES, is_pause_recent

_NAMES = {
    'coordinator': ('stream_reasoning_coordinator', 'Name of the coordinator node.'),
    'stream_manager': ('stream_manager', 'Name of the stream manager node.'),
    'ontology_manager': ('ontology_manager', 'Name of the ontology manager node.'),
    'folder': ('~/.ros/dyknow/black_boxes', 'Folder of the black boxes; it is made if needed.'),
    'robot': ('', 'robot.yaml of the system, whose text is put into the boxes.'),
    'snapshot_service': (
        '',
        'Snapshot service of a recorder of rosbag2, which is called instead of writing boxes.',
    ),
}
_LIMITS = {
    'memory_bytes': (200_000_000, 'Bytes of all messages that are kept in memory.'),
    'memory_messages': (200_000, 'Messages that are kept in memory.'),
    'folder_bytes': (1_000_000_000, 'Bytes of all boxes; the oldest are removed for new ones.'),
    'max_boxes': (100, 'Boxes in the folder; the oldest are removed for new ones.'),
    'max_per_minute': (
        10,
        'Boxes that are written within a minute; up to half are kept for first failures.',
    ),
}


PERIOD_S: Final = 0.1
"""The period in which boxes are closed, and publishers are looked for."""

REPORT_PERIOD_S: Final = 1.0

STOP_TIMEOUT_S: Final = 3.0
"""The time that the box which is being written at a stop may take."""

BOXES: Final = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The profile of `~/black_boxes`."""


class BlackBoxRecorder(DyKnowNode):
    """Keeps the topics of formulas with a black box in memory, and writes boxes when they fail."""

    def __init__(self) -> None:
        super().__init__('black_box_recorder')
        PAUSES.start()
        settings = self._settings = RecorderSettings.declare(self)
        self._snapshot = (
            SnapshotService(self, settings.snapshot_service) if settings.snapshot_service else None
        )
        self._configuration = _configuration(settings.robot)
        self._ring = MessageRing(settings.memory_bytes, settings.memory_messages)
        self._folder = BoxFolder(
            settings.path,
            self.get_fully_qualified_name(),
            settings.folder_bytes,
            settings.max_boxes,
        )
        self._topics = RawTopics(self, self._keep, self._ring.remove)
        self._origins = FormulaOrigins(self, settings.stream_manager, settings.ontology_manager)
        # Simulated time may not have begun.
        self._watch = FailureWatch(self.now(), settings.max_per_minute)
        self._writing = BoxWriting(self)
        self._written: dict[OpenBox, Future] = {}
        self._written_count = 0
        self._latest_fault = ''
        self._has_report = False
        self._reported_drops = 0
        self._boxes = self.create_publisher(BlackBoxReport, '~/black_boxes', BOXES)
        self._diagnostics = DiagnosticsPublisher(self)
        topic = f'{settings.coordinator}/evaluations'
        self.create_report_subscription(
            EvaluationStatusArray, topic, self._on_evaluations, callback_group=self.reentrant
        )
        self.create_timer(PERIOD_S, self._update, clock=self.wall_clock)
        self.create_timer(REPORT_PERIOD_S, self._report_health, clock=self.wall_clock)
        self.serve(SaveBlackBox, self._save)

    def destroy_node(self) -> None:
        """Write the boxes that wait or are open, then destroy the node."""
        unwritten = self._writing.stop(STOP_TIMEOUT_S)
        if unwritten is None:
            self.get_logger().error('a black box is lost: it takes too long to write')
        else:
            for each in self._watch.watched.values() if self._snapshot is None else ():
                if each.box is not None:
                    unwritten[each.box] = self._selected(each.box)[0]
            for box, write in unwritten.items():
                self._write_at_the_end(box, write)
        super().destroy_node()

    def _write_at_the_end(self, box: OpenBox, write: WriteBox) -> None:
        try:
            self.get_logger().info(f'{box.status.name}: wrote {write()} at the end')
        except DyKnowError as error:
            self.get_logger().error(f'{box.status.name}: {error}')

    def _on_evaluations(self, report: Any) -> None:
        statuses = [status_from_message(each) for each in report.evaluations if each.record]
        known = set(self._watch.watched)
        if not self._has_report:
            self._has_report = True
            self._warn_of_missed(statuses)
        lost = self._watch.update(statuses, self.now())
        for status in statuses:
            key = status.name, status.started
            if key in self._watch.watched:
                self._follow(key, status)
                if key not in known:
                    self._warn_of_horizon(status)
        if self._watch.watched and not known and self._snapshot is None:
            self._check_folder()
        self._follow_topics()
        for each in lost:
            self._report_fault(each.status, each.failure.reason, each.failure.time, each.error)

    def _warn_of_missed(self, statuses: Sequence[EvaluationStatus]) -> None:
        """Warn of the failures that a former run, which was killed, has not recorded."""
        for each in () if self._snapshot is not None else self._watch.missed(statuses):
            name, time = each.status.name, each.failure.time
            if not self._folder.has_box(name, time):
                self.get_logger().warning(f'{name}: {each.error} ({clock_time(time)})')

    def _check_folder(self) -> None:
        if fault := self._folder.fault:
            self._latest_fault = fault
            self.get_logger().error(fault)

    def _follow(self, key: FormulaKey, status: EvaluationStatus) -> None:
        origin = self._origins.note(key, status)
        options = self._watch.watched[key].options
        coordinator = self._settings.coordinator
        own = (
            status.state_stream,
            f'{coordinator}/evaluations',
            f'{coordinator}/verdicts/{verdict_token(status.name)}',
        )
        named = (*(options.topics or status.topics), *own)
        origin.topics |= {self.resolve_topic_name(each) for each in named if each}

    def _warn_of_horizon(self, status: EvaluationStatus) -> None:
        try:
            needed = horizon(status.formula)
        except DyKnowError:
            return  # The coordinator reports it.
        if status.record is not None and needed > status.record.before:
            before = round_duration(status.record.before)
            self.get_logger().warning(
                f'{status.name}: the black box begins {before} before a failure, but a verdict '
                f'depends on {round_duration(needed)}; a check of the box may have none; record '
                "with a longer 'before'"
            )

    def _update(self) -> None:
        """Follow the topics, drop old messages, and write the boxes that are due."""
        self._origins.refresh()
        # After a pause, messages of the time of a box may wait to be received.
        for box in () if is_pause_recent() else self._watch.due(self.now()):
            self._start_writing(box)
        self._follow_topics()

    def _follow_topics(self) -> None:
        if self._snapshot is not None:
            return
        now = self.now()
        kept: dict[str, int] = {}
        states: set[str] = set()
        for key in self._watch.watched:
            begin = self._watch.kept_from(key, now)
            states.add(self._origins[key].reported_stream)
            for topic in self._origins[key].topics:
                kept[topic] = min(kept.get(topic, begin), begin)
        for topic in self._topics.follow(kept, states):
            self._ring.remove(topic)
        # After a pause, a failure may be reported later than REPORT_DELAY_NS.
        for topic, begin in () if is_pause_recent() else kept.items():
            self._ring.forget(topic, begin)
        self._origins.keep(self._watch.watched)

    def _keep(self, topic: str, time: int, data: bytes, is_latched: bool) -> None:  # noqa: FBT001
        self._ring.add(topic, time, data, is_latched=is_latched)

    def _start_writing(self, box: OpenBox) -> None:
        if self._snapshot is not None:
            self.spawn(self._finish, box, self._snapshot.take)
            return
        write, *counts = self._selected(box)
        search = self._origins.search(box.key)
        self.spawn(self._finish, box, lambda: self._writing.write(box, search, write), *counts)

    def _selected(self, box: OpenBox) -> tuple[Any, int, int]:
        """Return a function that writes a box, and the numbers of its messages and of the drops."""
        origin = self._origins[box.key]
        messages = self._ring.messages(origin.topics, box.begin, box.end)
        offers = {each: self._topics.offer(each) for each in origin.topics}
        topics = {topic: offer for topic, offer in offers.items() if offer is not None}
        messages = [each for each in messages if each.topic in topics]
        versions, configuration = _versions(), self._configuration
        sources = {self.resolve_topic_name(each) for each in box.status.topics}
        box.recorded_from = self._topics.recorded_from({*sources, origin.state_stream})
        folder, logger = self._folder, self.get_logger()

        def write() -> Path:
            states = (each for each in messages if each.topic == origin.state_stream)
            numbers = [_state_number(each) for each in states]
            content = content_of(box, origin, numbers, versions, configuration)
            for fault in content.faults:
                logger.warning(f'{box.status.name}: {with_readable_times(fault)}')
            return folder.write(content, box.failure.time, messages, topics)

        dropped = self._ring.dropped_in(origin.topics, box.begin, box.end)
        if dropped:
            counts = listed(f'{number} of {topic}' for topic, number in sorted(dropped.items()))
            self.get_logger().warning(
                f'{box.status.name}: the black box lacks messages that the limits of memory have '
                f'removed: {counts}; raise memory_bytes or memory_messages, or record less'
            )
        return write, len(messages), sum(dropped.values())

    async def _finish(
        self,
        box: OpenBox,
        write: Callable[[], Awaitable[Path | None]],
        messages: int = 0,
        dropped: int = 0,
    ) -> None:
        """Have a box written, and report it; a snapshot has no path."""
        try:
            path = await write()
        except DyKnowError as error:
            self._end(box, error=error, dropped=dropped)
        except Exception as error:  # noqa: BLE001 - a request must get an answer
            self.log_fault('the writing of a black box', error)
            self._end(box, error=DyKnowError(f'fault in DyKnow: {error!r}'), dropped=dropped)
        else:
            self._end(box, path=str(path or ''), messages=messages, dropped=dropped)

    def _end(
        self,
        box: OpenBox,
        *,
        path: str = '',
        error: DyKnowError | None = None,
        messages: int = 0,
        dropped: int = 0,
    ) -> None:
        """Report a box that was written or could not be."""
        status, failure = box.status, box.failure
        if error is not None:
            self._report_fault(status, failure.reason, failure.time, error.message, dropped)
        else:
            self._latest_fault = ''
            self._written_count += 1
            report = _report(status, failure.reason, failure.time)
            report.path, report.messages, report.dropped = path, messages, dropped
            self._boxes.publish(report)
            what = f'wrote {path}' if path else 'a snapshot was taken'
            self.get_logger().info(f'{status.name}: {failure.reason}: {what}')
        if (waiting := self._written.pop(box, None)) is not None:
            waiting.set_result((path, error))

    def _report_fault(
        self, status: EvaluationStatus, reason: str, time: int, error: str, dropped: int = 0
    ) -> None:
        self._latest_fault = f'{status.name}: {error}'
        self.get_logger().error(self._latest_fault)
        report = _report(status, reason, time)
        report.error, report.dropped = error, dropped
        self._boxes.publish(report)

    async def _save(self, request: Any, response: Any) -> None:
        """Write boxes as if formulas failed now.

        Raises:
            DyKnowError: NOT_FOUND, if no formula has the name; UNAVAILABLE, if one is not written.
        """
        name = request.name
        boxes, lost = self._watch.request(name, self.now())
        if not boxes and not lost:
            known = listed(sorted({each for each, _ in self._watch.watched})) or 'none'
            wanted = f"'{name}'" if name else 'any name'
            raise DyKnowError(
                f'no formula of {wanted} is monitored with a black box (there are: {known})',
                ExitCode.NOT_FOUND,
            )
        for each in lost:
            self._report_fault(each.status, each.failure.reason, each.failure.time, each.error)
        waiting = [self._written.setdefault(box, Future()) for box in boxes]
        outcomes = [await each for each in waiting]
        errors = [each.error for each in lost] + [str(error) for _, error in outcomes if error]
        if errors:
            raise DyKnowError('\n'.join(errors), ExitCode.UNAVAILABLE)
        response.paths = [path for path, _ in outcomes if path]

    def _report_health(self) -> None:
        faults = [*self._topics.faults, *([self._latest_fault] if self._latest_fault else [])]
        drops = self._ring.dropped - self._reported_drops
        self._reported_drops = self._ring.dropped
        level, text = DiagnosticStatus.OK, f'{len(self._watch.watched)} formulas are recorded'
        if drops:
            level = DiagnosticStatus.WARN
            text = f'the limits of memory have removed {drops} messages within the last second'
        elif unknown := [
            key[0]
            for key in (self._watch.watched if self._snapshot is None else ())
            if not self._origins[key].has_streams
        ]:
            level = DiagnosticStatus.WARN
            text = f'the stream manager has not reported the streams of {listed(unknown)} yet'
        if faults:
            level, text = DiagnosticStatus.ERROR, faults[-1]
        values = {
            'formulas': len(self._watch.watched),
            'messages in memory': self._ring.count,
            'bytes in memory': self._ring.bytes,
            'removed by the limits of memory': self._ring.dropped,
            'boxes written': self._written_count,
            'boxes removed for new ones': self._folder.removed,
            'folder': self._settings.path,
        }
        self.set_status(text, {name: str(value) for name, value in values.items()}, level=level)
        status = DiagnosticStatus(
            level=level,
            name=f'{self.get_fully_qualified_name()}: black boxes',
            message=text,
            hardware_id='none',
            values=list(self.latest_status.values),
        )
        self._diagnostics.publish([status])


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """Values of the parameters of the recorder, which are their names."""

    coordinator: str
    stream_manager: str
    ontology_manager: str
    folder: str
    robot: str
    snapshot_service: str
    memory_bytes: int
    memory_messages: int
    folder_bytes: int
    max_boxes: int
    max_per_minute: int

    @classmethod
    def declare(cls, node: DyKnowNode) -> Self:
        """Declare the parameters of a node, and return their values."""
        names = {name: node.parameter(name, *rest) for name, rest in _NAMES.items()}
        limits = {name: node.parameter(name, *rest, (1, 10**12)) for name, rest in _LIMITS.items()}
        return cls(**names, **limits)

    @property
    def path(self) -> Path:
        """The folder of the black boxes."""
        return Path(self.folder).expanduser().absolute()


def _report(status: EvaluationStatus, reason: str, time: int) -> BlackBoxReport:
    return BlackBoxReport(
        stamp=nanoseconds_to_time(max(time, 0)),
        name=status.name,
        formula=status.formula,
        reason=reason,
    )


def _state_number(message: SerialisedMessage) -> RecordedStateNumber:
    state = deserialize_message(message.data, Sample)
    return RecordedStateNumber(state.stream_id, state.number, time_to_nanoseconds(state.valid_time))


def _versions() -> Mapping[str, str]:
    found = {'ros': os.environ.get('ROS_DISTRO', '')}
    for package in ('dyknow_reactions', 'rosbags'):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = ''
    return found


def _configuration(robot: str) -> Mapping[str, str]:
    """Return the text of a robot.yaml by its path; empty without one."""
    if not robot:
        return {}
    return {robot: read_text(Path(robot), 'configuration', DyKnowError)}


def main() -> int:
    """Run the executable black_box_recorder."""
    return run(BlackBoxRecorder)
