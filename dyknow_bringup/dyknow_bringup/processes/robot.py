"""The system of a robot that a robot.yaml describes."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.processes import SystemConfiguration
from dyknow_bringup.resources import uav_robot_path
from dyknow_common import read_text
from dyknow_configuration import RobotConfiguration, read_robot, write_texts
from dyknow_stream_processing import parse_specification, specifications_by_sink


def with_robot(
    configuration: SystemConfiguration, path: Path, *, monitor: bool = True
) -> SystemConfiguration:
    """Return a configuration with what a robot.yaml describes added to it.

    The recorder of black boxes is started if a formula asks for one. If there are formulas, a
    monitor is started, unless `monitor` is False.

    The nodes read files: the texts of the robot are written to a folder that exists as long as this
    process.

    Raises:
        DyKnowError: with the place of a fault in the file.
    """
    robot = read_robot(path)
    if robot.domains:
        raise BringupError(
            f"{path}: 'domains' is for recordings only, as a running system takes the objects of "
            "its ontologies; list them as 'objects' instead"
        )
    if configuration.recorder is not None or any(each.record for each in robot.formulas):
        recorder = {'robot': str(path.absolute()), **(configuration.recorder or {})}
        configuration = replace(configuration, recorder=recorder)
    guards = {each.name: path.resolve() for each in robot.guards}
    written = added(
        configuration, write_texts(robot, temporary_folder(), path.stem, with_places=True)
    )
    return replace(
        written,
        guards=guards,
        federated=path.resolve() if robot.federation else None,
        monitored=path.resolve() if monitor and robot.formulas else None,
    )


def fleet_configuration(vehicles: Sequence[str]) -> SystemConfiguration:
    """Return the configuration for a fleet of UAVs: robots/uav.yaml with these vehicles."""
    robot = read_robot(uav_robot_path(), {'UAV': vehicles})
    return added(SystemConfiguration(), write_texts(robot, temporary_folder(), 'uav'))


def requested_streams(configuration: SystemConfiguration) -> set[str]:
    """Return the names of the streams that a configuration requests."""
    specifications = (
        parse_specification(read_text(path, 'streams', BringupError))
        for path in configuration.streams
    )
    return {name for each in specifications for name in specifications_by_sink(each)}


def added(configuration: SystemConfiguration, robot: RobotConfiguration) -> SystemConfiguration:
    """Return a configuration with the files and parameters of a robot."""

    def paths(kind: str) -> tuple[Path, ...]:
        files = tuple(each for each in getattr(robot, kind) if isinstance(each, Path))
        return (*files, *getattr(configuration, kind))

    return replace(
        configuration,
        ontologies=paths('ontologies'),
        annotations=paths('annotations'),
        streams=paths('streams'),
        bridges=paths('bridges'),
        parameters=robot.parameters,
    )


def temporary_folder() -> Path:
    """Return a new folder that is removed at the end of this process."""
    folder = Path(tempfile.mkdtemp(prefix='dyknow_'))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
