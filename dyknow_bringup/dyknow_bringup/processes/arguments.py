"""Arguments of launch files that configure DyKnow, and the files of ROS parameters they name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.processes import Process, SystemConfiguration, robot_processes
from dyknow_bringup.processes.robot import temporary_folder, with_robot
from dyknow_common import read_text
from dyknow_configuration import warn_of_misspelt_names

_NODE: Final = re.compile(
    r"""^(?P<quote>["']?)(?P<name>\w+)(?P=quote):(?=[ \t]*(?:\#[^\n]*)?\n"""
    r"""(?:[ \t]*(?:\#[^\n]*)?\n)*[ \t]+ros__parameters:)""",
    re.MULTILINE,
)
"""The name of a node without a namespace, with its parameters below it."""

CONFIGURATION: Final = {
    'config': ('', 'robot.yaml, which describes the robot'),
    'monitor': ('true', 'monitor the formulas of the robot.yaml, and run their triggers'),
    'ontology': ('', 'OWL files, separated by commas'),
    'annotations': ('', 'files in SSL, separated by commas'),
    'streams': ('', 'files in the stream language, separated by commas'),
    'bridges': ('', 'files of bridge rules between the ontologies, separated by commas'),
    'store': ('', 'a folder that keeps changes of the ontology and of the annotations'),
    'reasoner': ('', 'structural, hermit or pellet; the last two need Java'),
    'params_file': ('', 'ROS file of parameters of the nodes; it takes precedence over the others'),
    'engines': ('1', 'number of stream processing engines'),
    'record': ('', 'folder of black boxes, which are recorded where formulas ask for them'),
}
"""The arguments that configure one system, with their defaults and descriptions."""

ROBOT: Final = '<robot>'
"""Stands for the namespace of a robot in the arguments of `robots`."""


def for_any_namespace(path: Path) -> Path:
    """Return a file of parameters for the nodes in any namespace.

    ROS takes `stream_manager:` for the node in the root namespace, and ignores it for others. It
    ignores misspelt names, too, which are warned of.

    Args:
        path: the path of a file; where its names have a namespace or a wildcard, they remain.
    """
    try:
        text = read_text(path, 'parameters', BringupError)
    except BringupError:
        return path  # Checks of the configuration, or the nodes, say what is wrong with it.
    warn_of_misspelt_names(path)
    changed = _NODE.sub(r'/**/\g<name>:', text)
    if changed == text:
        return path
    copy = temporary_folder() / path.name
    copy.write_text(changed, encoding='utf-8')
    return copy


def configuration(
    values: Mapping[str, str], changed: Callable[[Path], Path] = for_any_namespace
) -> SystemConfiguration:
    """Return the configuration that the values of the arguments describe.

    Args:
        values: the values of the arguments.
        changed: returns the file of parameters to use in place of the given one.

    Raises:
        DyKnowError: if a file or a value is wrong.
    """
    store, params_file, record = values['store'], values['params_file'], values['record']
    files = SystemConfiguration(
        ontologies=_files(values['ontology']),
        annotations=_files(values['annotations']),
        streams=_files(values['streams']),
        bridges=_files(values['bridges']),
        store=Path(store).resolve() if store else None,
        reasoner=values['reasoner'],
        params_file=changed(Path(params_file).resolve()) if params_file else None,
        engines=number('engines', values['engines']),
        recorder={'folder': str(Path(record).resolve())} if record else None,
    )
    monitor = is_true('monitor', values['monitor'])
    if values['config']:
        return with_robot(files, Path(values['config']).resolve(), monitor=monitor)
    return files


def robots(values: Mapping[str, str]) -> tuple[Process, ...]:
    """Return the nodes of DyKnow for each robot.

    Args:
        values: the values of the arguments of one system, and the namespaces as `robots`.

    Raises:
        BringupError: if the namespaces cannot be used, or the robots would share a store.
    """
    namespaces = _listed(values['robots'])
    # A file that is the same for all is changed once, and warned of once.
    changed = cache(for_any_namespace)
    configurations = [
        configuration(
            {name: text.replace(ROBOT, each.strip('/')) for name, text in values.items()}, changed
        )
        for each in namespaces
    ]
    processes = robot_processes(namespaces, configurations)
    stores = [each.store for each in configurations if each.store]
    if len(set(stores)) < len(stores):
        raise BringupError(
            f"the robots cannot share the store '{values['store']}'; name a folder for each, such "
            f'as {values["store"]}/{ROBOT}'
        )
    return processes


def is_true(name: str, value: str) -> bool:
    """Return the value of a boolean launch argument.

    Raises:
        BringupError: for another text than launch itself accepts.
    """
    text = value.lower()
    if text not in {'true', '1', 'false', '0'}:
        raise BringupError(f"{name}: '{value}' is neither true nor false")
    return text in {'true', '1'}


def number(name: str, text: str) -> int:
    """Return the value of a launch argument.

    Raises:
        BringupError: if it is no whole number.
    """
    try:
        return int(text)
    except ValueError:
        raise BringupError(f"{name}: '{text}' is not a whole number") from None


def _files(text: str) -> tuple[Path, ...]:
    return tuple(Path(path).resolve() for path in _listed(text))


def _listed(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (each.strip() for each in text.split(','))))
