from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.recording import STORAGES, record
from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common import NANOSECONDS, ExitCode
from dyknow_recordings import Bag, QualityOfService, RecordedTopic, RecordingError

SECOND = NANOSECONDS['s']
START = 1_700_000_000 * SECOND
FLEET = vehicle_names(3)
OFFERED = QualityOfService(reliable=True, transient_local=False, depth=10)


@pytest.fixture(scope='module', params=STORAGES)
def recording(
    request: pytest.FixtureRequest,
    scenarios: dict[str, Scenario],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    path = tmp_path_factory.mktemp('bags') / 'power_surge'
    record(scenarios['power_surge'], FLEET, START, path, request.param)
    return path


def test_what_is_recorded_is_what_was_simulated(
    recording: Path, scenarios: dict[str, Scenario]
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    scenario = scenarios['power_surge']
    telemetry = list(Simulation(scenario, FLEET, START).until(START + scenario.duration))
    with Bag(recording) as bag:
        messages = list(bag.messages())
        assert bag.start_time == telemetry[0].delivery_time
        assert bag.end_time == telemetry[-1].delivery_time
    assert len(messages) == len(telemetry)
    for message, original in zip(messages, telemetry, strict=True):
        assert message.log_time == original.delivery_time
        assert message.topic == f'/{original.vehicle}/{original.channel}'
        stamp = store.deserialize_cdr(message.data, message.message_type).header.stamp
        assert stamp.sec * SECOND + stamp.nanosec == original.stamp


def test_topics_tell_type_count_and_quality(recording: Path) -> None:
    with Bag(recording) as bag:
        assert bag.topics[:2] == (
            RecordedTopic('/uav1/battery', 'sensor_msgs/msg/BatteryState', 100, OFFERED),
            RecordedTopic('/uav1/odometry', 'nav_msgs/msg/Odometry', 400, OFFERED),
        )
        assert len(bag.topics) == 6


def test_a_recording_is_small(recording: Path) -> None:
    assert sum(path.stat().st_size for path in recording.iterdir()) < 400_000


def test_some_topics(recording: Path) -> None:
    wanted = {'/uav1/battery', '/uav3/battery'}
    with Bag(recording) as bag:
        everything = list(bag.messages())
        some = list(bag.messages(wanted))
    assert some == [message for message in everything if message.topic in wanted]
    assert len(some) == 200


def test_a_topic_that_was_not_recorded(recording: Path) -> None:
    with Bag(recording) as bag, pytest.raises(RecordingError) as error:
        bag.messages(['/uav1/odometri'])
    assert error.value.code == ExitCode.NOT_FOUND
    assert str(error.value) == (
        f"{recording}: unknown topic '/uav1/odometri'; did you mean '/uav1/odometry'?"
    )


def test_a_single_file_is_a_bag(recording: Path) -> None:
    (file,) = (path for path in recording.iterdir() if path.suffix in {'.mcap', '.db3'})
    with Bag(file) as bag:
        assert len(list(bag.messages(['/uav2/battery']))) == 100


@pytest.mark.parametrize('name', ['nominal', 'power_surge'])
def test_the_shipped_recordings(share: Path, scenarios: dict[str, Scenario], name: str) -> None:
    scenario = scenarios[name]
    telemetry = list(Simulation(scenario, FLEET, START).until(START + scenario.duration))
    with Bag(share / 'recordings' / name) as bag:
        messages = [(message.log_time, message.topic) for message in bag.messages()]
    assert messages == [
        (message.delivery_time, f'/{message.vehicle}/{message.channel}') for message in telemetry
    ]


def test_recording_over_another(recording: Path, scenarios: dict[str, Scenario]) -> None:
    with pytest.raises(BringupError) as error:
        record(scenarios['nominal'], FLEET, START, recording)
    assert error.value.code == ExitCode.ALREADY_EXISTS
    assert str(error.value) == f'{recording}: exists already; move it away'


def test_recording_in_an_unknown_storage(tmp_path: Path, scenarios: dict[str, Scenario]) -> None:
    with pytest.raises(BringupError) as error:
        record(scenarios['nominal'], FLEET, START, tmp_path / 'bag', 'tape')
    assert str(error.value) == "no storage 'tape'; the storages are mcap, sqlite3"


def test_an_empty_bag(tmp_path: Path) -> None:
    path = tmp_path / 'empty'
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP):
        pass
    with Bag(path) as bag:
        assert list(bag.messages()) == []
        assert bag.topics == ()
        with pytest.raises(RecordingError, match='the recording has no messages'):
            _ = bag.start_time
        with pytest.raises(RecordingError, match='the recording has no messages'):
            _ = bag.end_time


def test_a_bag_without_quality_of_service(tmp_path: Path) -> None:
    path = tmp_path / 'plain'
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/armed', 'std_msgs/msg/Bool', typestore=store)
        writer.write(connection, START, b'\x00\x01\x00\x00\x01')
    with Bag(path) as bag:
        assert bag.topics == (RecordedTopic('/armed', 'std_msgs/msg/Bool', 1, None),)
        (message,) = bag.messages()
        assert message.data == b'\x00\x01\x00\x00\x01'
        assert bag.start_time == bag.end_time == START
