"""Installed files: scenarios, plans, formulas, the ontology, recordings and executables."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_prefix

from dyknow_bringup.errors import BringupError
from dyknow_common import ExitCode
from dyknow_common.executables import SOURCE_ENVIRONMENT


def share() -> Path:
    """Return the folder of the package's data.

    Raises:
        BringupError: NOT_FOUND, outside of the environment in which it is installed.
    """
    return _prefix('dyknow_bringup') / 'share' / 'dyknow_bringup'


def scenario_names() -> tuple[str, ...]:
    """Return the names of the shipped scenarios."""
    return _names('scenario')


def scenario_path(scenario: str, *others: str) -> Path:
    """Return the file of a scenario, given its name or a path.

    Raises:
        BringupError: NOT_FOUND, with the names of the shipped scenarios, and of others.
    """
    return _path('scenario', scenario, *others)


def plan_path(plan: str) -> Path:
    """Return the file of a plan, given its name or a path.

    Raises:
        BringupError: NOT_FOUND, with the names of the shipped plans.
    """
    return _path('plan', plan)


def formulas_path() -> Path:
    """Return the file with the formulas of the demonstration."""
    return share() / 'formulas' / 'uav.yaml'


def uav_robot_path() -> Path:
    """Return the file that describes the UAVs of the demonstration."""
    return share() / 'robots' / 'uav.yaml'


def host_path(name: str) -> Path:
    """Return the robot.yaml of a host of the fleet that is federated: `basestation`, `carrier1`."""
    return share() / 'robots' / 'fleet' / f'{name}.yaml'


def executable_path(package: str, executable: str) -> Path:
    """Return the file of an executable of an installed package.

    Raises:
        BringupError: NOT_FOUND, if it is not installed.
    """
    prefix = _prefix(package)
    for folder in (prefix / 'lib' / package, prefix / 'bin'):
        if (folder / executable).is_file():
            return folder / executable
    raise BringupError(
        f"package '{package}' has no executable '{executable}'; build the workspace again",
        ExitCode.NOT_FOUND,
    )


def _prefix(package: str) -> Path:
    try:
        return Path(get_package_prefix(package))
    except (OSError, LookupError) as error:
        raise BringupError(f'{error.args[0]}; {SOURCE_ENVIRONMENT}', ExitCode.NOT_FOUND) from None


def _names(kind: str) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in (share() / f'{kind}s').glob('*.yaml')))


def _path(kind: str, name: str, *others: str) -> Path:
    path = Path(name)
    if path.suffix != '.yaml':
        path = share() / f'{kind}s' / f'{name}.yaml'
    if not path.is_file():
        raise BringupError(
            f"there is no {kind} '{name}'; use {', '.join([*_names(kind), *others])} or the "
            'path of a YAML file',
            ExitCode.NOT_FOUND,
        )
    return path
