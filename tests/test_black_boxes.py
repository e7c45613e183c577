"""Black boxes of a running system, which a check of the bag alone judges as the system did."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dyknow_interfaces.msg import (
    BlackBoxReport,
    BlackBoxRequest,
    ExitStatus,
    FormulaResult,
    StreamStatusArray,
)
from dyknow_interfaces.srv import InstanceCreate, InstanceDestroy, SaveBlackBox
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from commands import command
from dyknow_bringup.processes.processes import Process
from dyknow_common.ros import LATCHED, nanoseconds_to_duration, time_to_nanoseconds
from dyknow_configuration import ParameterValue
from dyknow_recordings import BlackBoxContent, open_recording, read_black_box
from evaluations import Evaluations, Monitored, Spares
from system import POLL, SOON_NOTICED, Batteries, SharedSystem, System

INVARIANT = 'forall u in UAV: always Power[u] < 150'
RECOVERY = (
    'forall u in UAV: always (Power[u] > 150 -> '
    'Power[u] < 260 until[0 s, 1 s] always[0 s, 500 ms] Power[u] <= 150)'
)
NODE = 'black_box_recorder'
SECOND = 1_000_000_000

pytestmark = pytest.mark.usefixtures('calm')


@pytest.fixture(scope='module')
def system(shared_system: SharedSystem) -> System:
    return shared_system.get(parameters=SOON_NOTICED, composition=False)


class Recorder:
    """A recorder, and what it reports."""

    def __init__(self, system: System, folder: Path) -> None:
        self.folder = folder
        self.reports: list[BlackBoxReport] = []
        self.diagnosis: DiagnosticStatus | None = None
        self._system = system
        self._subscriptions: list[Any] = []

    def start(self, **parameters: ParameterValue) -> None:
        given = {'folder': str(self.folder), **parameters}
        self._stop_listening()
        self.process = self._system.launcher.start(Process('dyknow_reactions', NODE, given))
        node = self._system.client.node
        latched = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscriptions = [
            node.create_subscription(
                BlackBoxReport, f'{NODE}/black_boxes', self.reports.append, latched
            ),
            node.create_subscription(
                DiagnosticArray, '/diagnostics', self._hear, QoSProfile(depth=20)
            ),
        ]
        self.diagnosis = None
        self._system.client.spin_until(lambda: self.diagnosis is not None, 'the recorder')

    def stop(self) -> None:
        self._stop_listening()
        self._system.launcher.stop(NODE)

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """A recorder that does nothing for a while, and does not even notice."""
        self.process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self.process.send_signal(signal.SIGCONT)

    def wait_for_memory(self, formulas: int = 1) -> None:
        """Waits until all of so many formulas is known, and messages are in memory for a while."""
        self._system.client.spin_until(
            lambda: (
                self.level == DiagnosticStatus.OK
                and self.value('formulas') == formulas
                and self.value('messages in memory') > 20
            ),
            'messages in the memory of the recorder',
            instead=lambda: self.diagnosis,
        )

    @property
    def level(self) -> bytes | None:
        """The level of its latest diagnosis."""
        return None if self.diagnosis is None else self.diagnosis.level

    def value(self, key: str) -> int:
        values = {} if self.diagnosis is None else {e.key: e.value for e in self.diagnosis.values}
        return int(values.get(key, 0))

    def wait_for_reports(self, count: int) -> list[BlackBoxReport]:
        self._system.client.spin_until(
            lambda: len(self.reports) >= count,
            f'{count} reports of black boxes',
            instead=lambda: self.diagnosis,
        )
        return self.reports

    def _stop_listening(self) -> None:
        while self._subscriptions:
            self._system.client.node.destroy_subscription(self._subscriptions.pop())

    def _hear(self, array: DiagnosticArray) -> None:
        for each in array.status:
            if each.name.endswith(f'{NODE}: black boxes'):
                self.diagnosis = each


@pytest.fixture
def recorder(system: System, tmp_path: Path) -> Iterator[Recorder]:
    recorder = Recorder(system, tmp_path / 'boxes')
    yield recorder
    recorder.stop()


def recorded(before: float = 10.0, after: float = 1.0, topics: tuple[str, ...] = ()) -> Any:
    """Return the field `record` of a goal."""
    times = {'before': before, 'after': after}
    durations = {
        name: nanoseconds_to_duration(round(time * SECOND)) for name, time in times.items()
    }
    return [BlackBoxRequest(topics=list(topics), **durations)]


def checked(path: str) -> tuple[int, dict[str, Any]]:
    """Return the exit code and the results of `dyknow check` of a black box alone."""
    done = subprocess.run(
        [*command('dyknow'), 'check', path, '--json'], capture_output=True, text=True, check=False
    )
    assert done.stderr == ''
    return done.returncode, json.loads(done.stdout)


def content(path: str) -> BlackBoxContent:
    found = read_black_box(Path(path))
    assert found is not None
    return found


@pytest.mark.parametrize('formula', [INVARIANT, RECOVERY])
def test_a_false_formula_has_the_same_verdict_offline(
    system: System,
    recorder: Recorder,
    batteries: Batteries,
    evaluations: Evaluations,
    formula: str,
) -> None:
    recorder.start()
    # The topics are recorded, and the states made, before the first state of the formula.
    other = Monitored(
        system.client, 'forall u in UAV: Power[u] < 999', every_state=True, record=recorded()
    )
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    monitored = Monitored(system.client, formula, name='power', record=recorded(), margin=True)
    (_, status) = evaluations.wait_for_state(2)
    assert set(status.topics) == {'/uav1/battery', '/uav2/battery'}
    recorder.wait_for_memory(2)
    batteries.power['uav2'] = 240.0
    result = monitored.result()
    assert result.verdict == FormulaResult.FALSE
    (report,) = recorder.wait_for_reports(1)
    assert (report.name, report.reason, report.error) == ('power', 'false', '')
    assert report.dropped == 0
    other.end()
    code, document = checked(report.path)
    (found,) = document['formulas']
    (episode,) = found['episodes']
    assert (code, found['outcome'], document['notes']) == (1, 'false', [])
    assert episode['decided_at_ns'] == time_to_nanoseconds(result.decided_at)
    assert episode['explanation'] == result.explanation
    # The formula has plain numbers, and the box knows no ontology.
    assert (episode['margin']['unit'], result.margin.unit) == ('W', 'W')
    with open_recording(Path(report.path)) as recording:
        names = {each.name for each in recording.topics}
        assert {'/uav1/battery', '/uav2/battery', status.state_stream} <= names
        assert '/stream_reasoning_coordinator/evaluations' in names
        assert sum(each.message_count for each in recording.topics) == report.messages
        after = recording.end_time - time_to_nanoseconds(result.decided_at)
    assert after > SECOND
    found_content = content(report.path)
    assert found_content.domains == {'UAV': ['uav1', 'uav2']}
    assert found_content.is_complete


def test_a_box_has_the_objects_of_the_last_restart(
    system: System,
    recorder: Recorder,
    batteries: Batteries,
    evaluations: Evaluations,
    spares: Spares,
) -> None:
    recorder.start()
    monitored = Monitored(
        system.client, INVARIANT, name='power', record=recorded(), restart_on_change=True
    )
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    names = {'instance_name': 'uav3', 'concept_names': ['UAV']}
    system.client.call(InstanceCreate, 'ontology_manager/instance_create', **names)
    spares.power('uav3_power', 'uav1', of='uav3')
    evaluations.wait_for_event('restarted', 'uav3')
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    batteries.power['uav1'] = 240.0
    result = monitored.result()
    batteries.power['uav1'] = 100.0
    (report,) = recorder.wait_for_reports(1)
    spares.clear()
    system.client.call(InstanceDestroy, 'ontology_manager/instance_destroy', instance_name='uav3')
    assert content(report.path).domains == {'UAV': ['uav1', 'uav2', 'uav3']}
    code, document = checked(report.path)
    (found,) = document['formulas']
    assert (code, found['outcome'], document['notes']) == (1, 'false', [])
    # The topic of uav3 is recorded from the restart on, maybe after the first state.
    assert result.explanation.startswith(found['episodes'][0]['explanation'].partition(' (')[0])


def test_an_episode_has_a_box(
    system: System, recorder: Recorder, batteries: Batteries, evaluations: Evaluations
) -> None:
    recorder.start()
    monitored = Monitored(
        system.client,
        'forall u in UAV: Power[u] < 150',
        name='always low',
        every_state=True,
        record=recorded(after=0.5),
    )
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    batteries.power['uav1'] = 240.0
    (report,) = recorder.wait_for_reports(1)
    batteries.power['uav1'] = 100.0
    assert (report.reason, report.error) == ('episode', '')
    (status,) = evaluations.running
    (episode,) = status.episodes.latest_episodes
    monitored.end()
    code, document = checked(report.path)
    (found,) = document['formulas']
    failed = [each for each in found['episodes'] if each['verdict'] == 'false']
    assert (code, failed[0]['begin_ns']) == (1, time_to_nanoseconds(episode.begin))
    assert failed[0]['explanation'] == episode.explanation


def test_a_request_writes_what_there_is(
    system: System, recorder: Recorder, evaluations: Evaluations
) -> None:
    recorder.start()
    monitored = Monitored(system.client, INVARIANT, name='power', record=recorded(after=0.2))
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    answer = system.client.call(SaveBlackBox, f'{NODE}/save_black_box', name='power')
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    (path,) = answer.paths
    answer = system.client.call(SaveBlackBox, f'{NODE}/save_black_box', name='pwer')
    assert answer.exit_status.code == ExitStatus.NOT_FOUND
    assert answer.exit_status.message == (
        "no formula of 'pwer' is monitored with a black box (there are: power)"
    )
    monitored.end()
    (found,) = checked(path)[1]['formulas']
    assert found['outcome'] == 'undecided', (found['error'], found['events'])


def test_limits_of_memory_are_told(
    system: System, recorder: Recorder, evaluations: Evaluations
) -> None:
    recorder.start(memory_messages=30)
    monitored = Monitored(system.client, INVARIANT, name='power', record=recorded(after=0.2))
    evaluations.wait_for_state()
    system.client.spin_until(
        lambda: recorder.value('removed by the limits of memory') > 10, 'drops'
    )
    assert recorder.diagnosis is not None
    assert recorder.diagnosis.level == DiagnosticStatus.WARN
    (path,) = system.client.call(SaveBlackBox, f'{NODE}/save_black_box').paths
    (report,) = recorder.wait_for_reports(1)
    assert report.path == path
    assert report.dropped > 0
    monitored.end()


def test_a_folder_that_is_too_small_is_an_error(
    system: System, recorder: Recorder, evaluations: Evaluations
) -> None:
    recorder.start(folder_bytes=1000)
    monitored = Monitored(system.client, INVARIANT, name='power', record=recorded(after=0.2))
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    answer = system.client.call(SaveBlackBox, f'{NODE}/save_black_box', name='power')
    assert answer.exit_status.code == ExitStatus.UNAVAILABLE
    assert "which may have 1000 (the limit 'folder_bytes')" in answer.exit_status.message
    (report,) = recorder.wait_for_reports(1)
    assert (report.path, report.error) == ('', answer.exit_status.message)
    system.client.spin_until(
        lambda: recorder.level == DiagnosticStatus.ERROR, 'an error in the diagnostics'
    )
    monitored.end()


def test_a_recorder_that_is_killed_and_started_again(
    system: System, recorder: Recorder, batteries: Batteries, evaluations: Evaluations
) -> None:
    recorder.start()
    monitored = Monitored(system.client, INVARIANT, name='power', record=recorded(after=0.2))
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    system.launcher.kill(NODE)
    recorder.start()
    recorder.wait_for_memory()
    batteries.power['uav1'] = 240.0
    result = monitored.result()
    (report, *_) = recorder.wait_for_reports(1)
    (found,) = checked(report.path)[1]['formulas']
    assert found['error'] is None, (found['error'], found['events'])
    assert found['episodes'][0]['decided_at_ns'] == time_to_nanoseconds(result.decided_at)


def wait_for_telemetry(system: System, batteries: Batteries, duration: float) -> None:
    end = batteries.stamp + round(duration * SECOND)
    system.client.spin_until(lambda: batteries.stamp >= end, 'telemetry', pause=POLL)


@pytest.mark.parametrize('fails_meanwhile', [False, True])
def test_a_recorder_that_pauses_takes_no_sample_for_late(
    system: System,
    recorder: Recorder,
    batteries: Batteries,
    evaluations: Evaluations,
    fails_meanwhile: bool,  # noqa: FBT001
) -> None:
    recorder.start()
    monitored = Monitored(system.client, INVARIANT, name='power', record=recorded(after=0.2))
    evaluations.wait_for_state()
    recorder.wait_for_memory()
    with recorder.stopped():
        # The streams allow a delay of 1 s.
        wait_for_telemetry(system, batteries, 1.8)
        if fails_meanwhile:
            batteries.power['uav1'] = 240.0
            result = monitored.result()
    if not fails_meanwhile:
        wait_for_telemetry(system, batteries, 0.6)
        batteries.power['uav1'] = 240.0
        result = monitored.result()
    (report,) = recorder.wait_for_reports(1)
    code, document = checked(report.path)
    (found,) = document['formulas']
    assert (code, found['error'], document['notes']) == (1, None, [])
    assert found['episodes'][0]['decided_at_ns'] == time_to_nanoseconds(result.decided_at)


def test_a_recorder_that_hears_of_the_streams_late(
    system: System, recorder: Recorder, evaluations: Evaluations
) -> None:
    reports: list[StreamStatusArray] = []
    client = system.client
    subscription = client.node.create_subscription(
        StreamStatusArray, 'stream_manager/streams', reports.append, LATCHED
    )
    manager = Node('late_manager', context=client.context)
    publisher = manager.create_publisher(StreamStatusArray, '~/streams', LATCHED)
    recorder.start(stream_manager='late_manager')
    monitored = Monitored(client, INVARIANT, name='power', record=recorded(after=0.2))
    evaluations.wait_for_state()
    client.spin_until(lambda: recorder.level == DiagnosticStatus.WARN, 'a warning')
    assert recorder.diagnosis is not None
    assert recorder.diagnosis.message == (
        'the stream manager has not reported the streams of power yet'
    )
    (path,) = client.call(SaveBlackBox, f'{NODE}/save_black_box').paths
    (found,) = checked(path)[1]['formulas']
    assert found['error']['message'] == (
        'the black box does not know the streams of the formula, and so has no verdict (the stream '
        'manager had not reported the streams of the formula); name the formula and its '
        'configuration by options'
    )
    topic = evaluations.latest.state_stream
    client.spin_until(
        lambda: any(each.topic == topic for each in reports[-1].streams), 'the state stream'
    )
    publisher.publish(reports[-1])
    recorder.wait_for_memory()
    (path,) = client.call(SaveBlackBox, f'{NODE}/save_black_box').paths
    (found,) = checked(path)[1]['formulas']
    assert (found['outcome'], found['error']) == ('undecided', None)
    monitored.end()
    client.node.destroy_subscription(subscription)
    manager.destroy_node()


def test_a_snapshot_service_without_its_type_is_refused(system: System) -> None:
    launcher = system.launcher
    process = Process('dyknow_reactions', NODE, {'snapshot_service': '/rosbag2_recorder/snapshot'})
    assert launcher.start(process).wait() == 1
    (ended,) = launcher.ended()
    launcher.stop(NODE)
    assert ended.last_lines.splitlines()[-1] == (
        "snapshot_service is '/rosbag2_recorder/snapshot', but its type "
        'rosbag2_interfaces/srv/Snapshot is not installed; install '
        'ros-jazzy-rosbag2-interfaces, or leave out the parameter'
    )
