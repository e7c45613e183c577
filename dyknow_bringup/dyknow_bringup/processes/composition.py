"""The nodes of DyKnow in one process, or in a process each.

In one process they need a quarter of the memory, and pass states and results on directly. In
processes of their own, a fault of one ends no other, and each has its own keys (SROS2).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Final

from dyknow_bringup.processes.processes import Process, join_namespaces
from dyknow_bringup.processes.robot import temporary_folder
from dyknow_configuration import PACKAGES

NODES: Final = 'dyknow_nodes'
"""The executable with all nodes."""


def composed(processes: Iterable[Process], environment: Mapping[str, str]) -> tuple[Process, ...]:
    """Return the processes that run the nodes of DyKnow in one process for each namespace.

    Args:
        processes: a node each. Others than the seven of a namespace, such as more engines, stay
            processes of their own.
        environment: variables of the processes. Where ROS security is enabled, every node keeps its
            own process, as the keys belong to a process.
    """
    processes = tuple(processes)
    if environment.get('ROS_SECURITY_ENABLE') == 'true':
        return processes
    groups: dict[str, dict[str, Process]] = {}
    for each in processes:
        if each.executable in PACKAGES:
            groups.setdefault(each.namespace, {}).setdefault(each.executable, each)
    complete = [group.values() for group in groups.values() if len(group) == len(PACKAGES)]
    joined = set(map(id, chain.from_iterable(complete)))
    others = [each for each in processes if id(each) not in joined]
    return (*map(_in_one_process, complete), *others)


def _in_one_process(processes: Iterable[Process]) -> Process:
    """Return the process of nodes of one namespace; a file has the parameters of each."""
    nodes = tuple(processes)
    parameters = {
        f'/**/{each.executable}': {'ros__parameters': dict(each.parameters)}
        for each in nodes
        if each.parameters
    }
    file = temporary_folder() / 'parameters.yaml'
    # JSON is YAML.
    file.write_text(json.dumps(parameters), encoding='utf-8')
    return Process(
        'dyknow_bringup',
        NODES,
        namespace=nodes[0].namespace,
        parameter_file=file,
        params_file=nodes[0].params_file,
    )


def names_in(process: Process) -> tuple[str, ...]:
    """Return the names under which a process logs: its own, and its nodes'."""
    nodes = PACKAGES if process.executable == NODES else ()
    return process.name, *(join_namespaces(process.namespace, each).lstrip('/') for each in nodes)


def name_in(process: Process, logger: str) -> str:
    """Return the name under which a message of a process is shown: its node's, if known."""
    node = logger.rpartition('.')[2]
    names = names_in(process)
    return next((each for each in names if each.rpartition('/')[2] == node), process.name)
