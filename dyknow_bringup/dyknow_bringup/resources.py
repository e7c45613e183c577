"""The files that the package ships: scenarios, formulas, the ontology and recordings."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_prefix, get_package_share_directory

from dyknow_bringup.errors import BringupError
from dyknow_common import ExitCode


def share() -> Path:
    """The folder of the package's data."""
    return Path(get_package_share_directory('dyknow_bringup'))


def scenario_names() -> tuple[str, ...]:
    """The shipped scenarios."""
    return tuple(sorted(path.stem for path in (share() / 'scenarios').glob('*.yaml')))


def scenario_path(scenario: str) -> Path:
    """The file of a scenario, given its name or a path.

    Raises:
        BringupError: NOT_FOUND, naming the shipped scenarios.
    """
    path = Path(scenario)
    if path.suffix != '.yaml':
        path = share() / 'scenarios' / f'{scenario}.yaml'
    if not path.is_file():
        raise BringupError(
            f"there is no scenario '{scenario}'; use {', '.join(scenario_names())} or the path of "
            f'a YAML file',
            ExitCode.NOT_FOUND,
        )
    return path


def plan_path(plan: str) -> Path:
    """The file of a plan, given its name or a path.

    Raises:
        BringupError: NOT_FOUND, naming the shipped plans.
    """
    path = Path(plan)
    if path.suffix != '.yaml':
        path = share() / 'plans' / f'{plan}.yaml'
    if not path.is_file():
        names = sorted(each.stem for each in (share() / 'plans').glob('*.yaml'))
        raise BringupError(
            f"there is no plan '{plan}'; use {', '.join(names)} or the path of a YAML file",
            ExitCode.NOT_FOUND,
        )
    return path


def formulas_path() -> Path:
    """The formulas of the demonstration."""
    return share() / 'formulas' / 'uav.yaml'


def uav_ontology_path() -> Path:
    """The ontology of UAVs and their features."""
    return share() / 'ontology' / 'uav.owl'


def executable_path(package: str, executable: str) -> Path:
    """An executable of an installed package.

    Raises:
        BringupError: NOT_FOUND, when it is not installed.
    """
    path = Path(get_package_prefix(package)) / 'lib' / package / executable
    if not path.is_file():
        raise BringupError(
            f"package '{package}' has no executable '{executable}'; build the workspace again",
            ExitCode.NOT_FOUND,
        )
    return path
