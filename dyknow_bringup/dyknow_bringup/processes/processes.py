"""Processes of a running DyKnow: one list for launch files and scripts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_common import ExitCode, file_fault
from dyknow_configuration import PACKAGES, ParameterValue

ENGINE: Final = 'stream_processing_engine'
"""The executable of an engine, and the name of the first one."""

COORDINATOR: Final = 'stream_reasoning_coordinator'
"""The executable that evaluates formulas, and its name."""

RECORDER: Final = 'black_box_recorder'
"""The executable that records black boxes, and its name."""

FEDERATION: Final = 'federation'
"""The executable that joins other hosts, and its name."""

MONITOR: Final = 'formula_monitor'
"""The executable that monitors formulas, and its name."""

NO_TIMEOUT_S: Final = 1e9
"""The longest that a formula may be monitored: 30 years."""

KEEP_VERDICTS_S: Final = 86_400.0
"""Time for which verdicts of monitored formulas are reported, unless the parameters say another."""

MAX_ENGINES: Final = 32
"""The most stream processing engines of a system."""

_FILES: Final = ('ontologies', 'annotations', 'streams', 'bridges')


@dataclass(frozen=True, slots=True)
class Process:
    """A node in a process of its own, or several nodes in one.

    Args:
        package: the package with its executable.
        executable: the name of the executable.
        parameters: values that differ from the defaults.
        namespace: the namespace of the node, relative to the namespace of all nodes.
        node: the name of the node; empty: the executable's.
        parameter_file: a file with more parameters, of nodes by their names.
        params_file: a file of parameters for any nodes, as ROS has them, which takes precedence.
    """

    package: str
    executable: str
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    namespace: str = ''
    node: str = ''
    parameter_file: Path | None = None
    params_file: Path | None = None

    @property
    def name(self) -> str:
        """The name of the node with its namespace, `robot1/stream_manager`."""
        return join_namespaces(self.namespace, self.node or self.executable).lstrip('/')


@dataclass(frozen=True, slots=True)
class SystemConfiguration:
    """Configuration of DyKnow for a robot.

    Args:
        ontologies: OWL files.
        annotations: files in SSL.
        streams: files in the stream language, with a sink for each stream to create.
        bridges: files of bridge rules between the ontologies.
        store: a folder that keeps changes of the ontology and of the annotations; None: no store.
        reasoner: the reasoner of the ontology; empty for the node's default.
        parameters: the nodes' parameters, by name; the files and options above take precedence.
        params_file: a ROS parameter file; it takes precedence over all other parameters.
        engines: the number of stream processing engines.
        guards: their names, each with the robot.yaml that describes it.
        federated: the robot.yaml whose federation this host joins; None: it has no peers.
        monitored: the robot.yaml whose formulas are monitored from the start on; None: none are.
        recorder: parameters of the recorder of black boxes; None: it is not started.

    Raises:
        BringupError: NOT_FOUND, with the path of a file that does not exist; for a wrong number.
    """

    ontologies: tuple[Path, ...] = ()
    annotations: tuple[Path, ...] = ()
    streams: tuple[Path, ...] = ()
    bridges: tuple[Path, ...] = ()
    store: Path | None = None
    reasoner: str = ''
    parameters: Mapping[str, Mapping[str, ParameterValue]] = field(default_factory=dict)
    params_file: Path | None = None
    engines: int = 1
    guards: Mapping[str, Path] = field(default_factory=dict)
    federated: Path | None = None
    monitored: Path | None = None
    recorder: Mapping[str, ParameterValue] | None = None

    def __post_init__(self) -> None:
        """Check the files and the number of engines."""
        files = {kind: getattr(self, kind) for kind in _FILES}
        files['params_file'] = () if self.params_file is None else (self.params_file,)
        for kind, paths in files.items():
            for path in paths:
                if fault := file_fault(path):
                    raise BringupError(f'{kind}: {fault}', ExitCode.NOT_FOUND)
        if not 1 <= self.engines <= MAX_ENGINES:
            raise BringupError(
                f'{self.engines} is no number of stream processing engines; use 1 to {MAX_ENGINES}'
            )


def dyknow_processes(configuration: SystemConfiguration) -> tuple[Process, ...]:
    """Return the nodes of DyKnow: seven, further engines, and the optional ones."""
    store = configuration.store
    parameters = {
        'stream_manager': _parameters(streams=configuration.streams),
        'ontology_manager': _parameters(
            ontologies=configuration.ontologies,
            bridges=configuration.bridges,
            store=store and store / 'ontology.sqlite3',
            reasoner=configuration.reasoner,
        ),
        'stream_semantics_manager': _parameters(
            annotations=configuration.annotations, store=store and store / 'annotations.sqlite3'
        ),
    }
    given = dict(configuration.parameters)
    if configuration.monitored is not None:
        coordinator = given.get(COORDINATOR, {})
        given[COORDINATOR] = {'keep_ended': KEEP_VERDICTS_S, **coordinator}
    nodes = [
        Process(
            package, executable, {**given.get(executable, {}), **parameters.get(executable, {})}
        )
        for executable, package in PACKAGES.items()
    ]
    engine = next(each for each in nodes if each.executable == ENGINE)
    numbers = range(2, configuration.engines + 1)
    nodes += (replace(engine, node=f'{ENGINE}_{number}') for number in numbers)
    if configuration.recorder is not None:
        recorder = {**given.get(RECORDER, {}), **configuration.recorder}
        nodes.append(Process('dyknow_reactions', RECORDER, recorder))
    if configuration.federated is not None:
        robot = str(configuration.federated)
        nodes.append(Process('dyknow_federation', FEDERATION, {'robot': robot}))
    return _with_params_file(nodes, configuration)


def watching_processes(configuration: SystemConfiguration) -> tuple[Process, ...]:
    """Return the guards and the monitor of formulas, which must survive what they watch."""
    nodes = [
        Process('dyknow_reactions', 'guard', {'robot': str(path), 'guard': name}, node=name)
        for name, path in configuration.guards.items()
    ]
    if configuration.monitored is not None:
        robot = str(configuration.monitored)
        monitor = Process('dyknow_bringup', MONITOR, {'robot': robot, 'timeout': NO_TIMEOUT_S})
        nodes.append(monitor)
    return _with_params_file(nodes, configuration)


def _with_params_file(
    processes: Iterable[Process], configuration: SystemConfiguration
) -> tuple[Process, ...]:
    return tuple(replace(each, params_file=configuration.params_file) for each in processes)


def robot_processes(
    namespaces: Sequence[str], configurations: Sequence[SystemConfiguration]
) -> tuple[Process, ...]:
    """Return the nodes, guards and monitor of each of several robots in one ROS domain.

    Args:
        namespaces: the namespaces of the robots.
        configurations: the configurations of the robots, in the same order.

    Raises:
        BringupError: if namespaces are missing, equal or within each other.
    """
    _check_apart(namespaces)
    return tuple(
        replace(process, namespace=namespace)
        for namespace, configuration in zip(namespaces, configurations, strict=True)
        for process in (*dyknow_processes(configuration), *watching_processes(configuration))
    )


def uav_simulation(scenario: Path, vehicles: int) -> Process:
    """Return the simulation of a fleet."""
    return Process(
        'dyknow_bringup', 'uav_simulation', {'scenario': str(scenario), 'uavs': vehicles}
    )


def carrier_simulation(carrier: str, radius: float) -> Process:
    """Return the simulation of a carrier of the federated fleet; its circle's radius is in m."""
    return Process('dyknow_bringup', 'carrier_simulation', {'carrier': carrier, 'radius': radius})


def formula_monitor(formulas: Path) -> Process:
    """Return the node that monitors the formulas of a file and logs the answers."""
    return Process('dyknow_bringup', MONITOR, {'formulas': str(formulas)})


def formula_markers() -> Process:
    """Return the node that shows formulas in three-dimensional views."""
    return Process('dyknow_bringup', 'formula_markers')


def ros_arguments(
    process: Process, namespace: str, log_level: str, *, use_sim_time: bool
) -> list[str]:
    """Return the arguments of the command line that starts a process as a node."""
    parameters = {**process.parameters, 'use_sim_time': use_sim_time}
    arguments = ['--ros-args', '--log-level', log_level]
    node_namespace = join_namespaces(namespace, process.namespace)
    if node_namespace:
        arguments += ['-r', f'__ns:={node_namespace}']
    arguments += ['--enclave', enclave(process, namespace)]
    if process.node:
        arguments += ['-r', f'__node:={process.node}']
    # The last of several values counts, and values for all nodes count where the first one is.
    if process.parameter_file is not None:
        arguments += ['--params-file', str(process.parameter_file)]
    for name, value in parameters.items():
        # rclpy reads the values of parameters as YAML, and JSON is YAML.
        arguments += ['-p', f'{name}:={json.dumps(value)}']
    if process.params_file is not None:
        arguments += ['--params-file', str(process.params_file)]
    return arguments


def enclave(process: Process, namespace: str) -> str:
    """Return the enclave of a process, which has effect where ROS security is enabled."""
    return join_namespaces(namespace, process.name)


def join_namespaces(*namespaces: str) -> str:
    """Return `/fleet/robot1` for `fleet` and `robot1`; empty for the root namespace."""
    parts = filter(None, (each.strip('/') for each in namespaces))
    return ''.join(f'/{part}' for part in parts)


def _check_apart(namespaces: Sequence[str]) -> None:
    absolute = [f'{join_namespaces(each)}/' for each in namespaces]
    if not namespaces or '/' in absolute:
        raise BringupError(
            f'each robot needs a namespace (given: {", ".join(namespaces) or "none"}), '
            f'such as robot1, robot2'
        )
    for place, each in enumerate(absolute):
        for other in absolute[:place] + absolute[place + 1 :]:
            if each.startswith(other):
                raise BringupError(
                    f"namespace '{each[:-1]}' is that of another robot, or within it; a stream "
                    f'manager would use the engines of both'
                )


def _parameters(**values: tuple[Path, ...] | Path | str | None) -> dict[str, ParameterValue]:
    """Return the parameters that have a value, with texts for paths."""
    return {
        name: [str(path) for path in value] if isinstance(value, tuple) else str(value)
        for name, value in values.items()
        if value
    }
