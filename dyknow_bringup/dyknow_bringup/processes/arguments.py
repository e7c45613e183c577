"""The arguments of launch files that configure DyKnow."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.processes import Process, SystemConfiguration, robot_processes

CONFIGURATION: Final = {
    'ontology': ('', 'OWL files, separated by commas'),
    'annotations': ('', 'files in SSL, separated by commas'),
    'streams': ('', 'files in the stream language, separated by commas'),
    'bridges': ('', 'files of bridge rules between the ontologies, separated by commas'),
    'store': ('', 'a folder that keeps changes of the ontology and of the annotations'),
    'reasoner': ('', 'structural, hermit or pellet; the last two need Java'),
}
"""The arguments that configure one system, with their defaults and descriptions."""

ROBOT: Final = '<robot>'
"""Stands for the namespace of a robot in the arguments of `robots`."""


def configuration(values: Mapping[str, str]) -> SystemConfiguration:
    """Return the configuration that the values of the arguments describe."""
    names = ('ontology', 'annotations', 'streams', 'bridges')
    store = values['store']
    return SystemConfiguration(
        *(tuple(Path(path).resolve() for path in listed(values[name])) for name in names),
        store=Path(store).resolve() if store else None,
        reasoner=values['reasoner'],
    )


def robots(values: Mapping[str, str]) -> tuple[Process, ...]:
    """Return the nodes of DyKnow for each robot.

    Args:
        values: of the arguments of one system, and the namespaces as `robots`.

    Raises:
        BringupError: if the namespaces cannot be used, or the robots would share a store.
    """
    namespaces = listed(values['robots'])
    configurations = [
        configuration({name: text.replace(ROBOT, each) for name, text in values.items()})
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


def listed(text: str) -> tuple[str, ...]:
    """Return the entries of a list separated by commas."""
    return tuple(filter(None, (each.strip() for each in text.split(','))))
