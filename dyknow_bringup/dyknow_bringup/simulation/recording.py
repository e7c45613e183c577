"""A simulated scenario, recorded as a rosbag2 bag without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.telemetry import MESSAGE_TYPES, ros_message, topic
from dyknow_common import ExitCode
from dyknow_recordings import (
    MonitoringFiles,
    PictureFiles,
    RequestedFormula,
    bag_writer,
    evaluate_recording,
    offered_profile,
    open_recording,
)

STORAGES: Final = {
    'mcap': (StoragePlugin.MCAP, CompressionMode.STORAGE),
    'sqlite3': (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
}
"""The storage formats of rosbag2, with the compression (zstd) that suits each of them."""


def record(
    scenario: Scenario, vehicles: Sequence[str], start: int, path: Path, storage: str = 'mcap'
) -> None:
    """Write the telemetry of a whole scenario to a bag.

    Args:
        scenario: the scenario to simulate.
        vehicles: the names of the fleet.
        start: the time of the first stamp, in nanoseconds since the epoch.
        path: the folder to create.
        storage: `mcap` or `sqlite3`.

    Raises:
        BringupError: for an unknown storage, an existing folder, or missing vehicles.
    """
    if storage not in STORAGES:
        raise BringupError(f"no storage '{storage}'; the storages are {', '.join(STORAGES)}")
    if path.exists():
        raise BringupError(f'{path}: exists already; move it away', ExitCode.ALREADY_EXISTS)
    simulation = Simulation(scenario, vehicles, start)
    types = get_typestore(Stores.ROS2_JAZZY)
    offered = offered_profile(reliable=True, latched=False, depth=10)
    with bag_writer(path, *STORAGES[storage]) as writer:
        connections = {
            (vehicle, channel): writer.add_connection(
                f'/{topic(vehicle, channel)}',
                message_type,
                typestore=types,
                offered_qos_profiles=[offered],
            )
            for vehicle in vehicles
            for channel, message_type in MESSAGE_TYPES.items()
        }
        for telemetry in simulation.until(start + scenario.duration):
            message = ros_message(telemetry, types.types.__getitem__)
            data = types.serialize_cdr(message, MESSAGE_TYPES[telemetry.channel])
            key = telemetry.vehicle, telemetry.channel
            writer.write(connections[key], telemetry.delivery_time, data)


def write_flight_report(
    scenario: Scenario,
    vehicles: Sequence[str],
    start: int,
    files: MonitoringFiles,
    formulas: Iterable[RequestedFormula],
    folder: Path,
    pictures: PictureFiles,
) -> None:
    """Record the flight of a scenario, and write a page about formulas over it.

    Args:
        scenario: it determines the flight.
        vehicles: the names of the fleet.
        start: the time of the first stamp, in nanoseconds since the epoch.
        files: the configuration of DyKnow for the fleet.
        formulas: the formulas to check.
        folder: the folder for the recording.
        pictures: the files to write.

    Raises:
        DyKnowError: naming a file that cannot be written.
    """
    bag = folder / scenario.name
    record(scenario, vehicles, start, bag)
    with open_recording(bag) as recording:
        report = evaluate_recording(recording, list(formulas), files, keep_signals=True)
    pictures.add(report)
    pictures.close(())
