"""Interfaces of the nodes: the topics, services and actions that each of them uses."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Final

from dyknow_configuration import Trigger, TriggerKind

ENGINE: Final = 'stream_processing_engine'
COORDINATOR: Final = 'stream_reasoning_coordinator'

RECORDER: Final = 'black_box_recorder'

FEDERATION: Final = 'federation'

REMOTE_STREAMS: Final = 'dyknow/federation/*'
"""The topics of the streams of peers, of their violations and their watermarks."""

RECORDER_SERVICES: Final = ('save_black_box',)

GUARD_SERVICES: Final = ('reset',)

SERVICES: Final = {
    ENGINE: ('list_streams', 'stream_create_from_spec', 'stream_destroy'),
    'stream_manager': (
        'list_streams',
        'stream_create_from_spec',
        'stream_destroy',
        'stream_get_topic',
        'stream_register',
    ),
    'ontology_manager': (
        'concept_create',
        'concept_destroy',
        'concept_get_instances',
        'instance_create',
        'instance_destroy',
        'instance_get_concepts',
        'ontology_load',
        'ontology_query',
    ),
    'stream_semantics_manager': (
        'add_semantic_specification',
        'list_semantic_specifications',
        'remove_semantic_specification',
    ),
    'semantic_matching_engine': ('find_all_matching_streams',),
    'stream_reasoning_engine': (
        'formula_group_add_formula',
        'formula_group_create',
        'formula_group_destroy',
        'formula_group_evaluate',
        'formula_group_extract_symbols',
        'formula_group_remove_formula',
    ),
    COORDINATOR: ('cancel_evaluation', 'evaluate_formula', 'report_plan_action'),
}
"""The private services of the seven nodes."""

ACTIONS: Final = ('monitor_formula', 'monitor_plan')
"""The private actions of the coordinator."""

PARAMETER_SERVICES: Final = (
    'describe_parameters',
    'get_parameter_types',
    'get_parameters',
    'list_parameters',
    'set_parameters',
    'set_parameters_atomically',
)


@dataclass(frozen=True, slots=True)
class Interfaces:
    """Names of topics, services and actions, in which `*` stands for any text.

    Private names begin with `~/`; relative names are in the namespace of the system.

    Args:
        publishes: topics.
        subscribes: topics.
        serves: services.
        requests: services.
        executes: actions.
        calls: actions.
    """

    publishes: frozenset[str] = frozenset()
    subscribes: frozenset[str] = frozenset()
    serves: frozenset[str] = frozenset()
    requests: frozenset[str] = frozenset()
    executes: frozenset[str] = frozenset()
    calls: frozenset[str] = frozenset()

    def __or__(self, other: Interfaces) -> Interfaces:
        return Interfaces(
            *(getattr(self, each.name) | getattr(other, each.name) for each in fields(self))
        )

    def absolute(self, namespace: str, node: str) -> Interfaces:
        """Return the interfaces with absolute names.

        Args:
            namespace: the namespace of the system; empty for the root.
            node: the absolute name of the node that uses them.
        """
        return Interfaces(
            *(
                frozenset(absolute_name(name, namespace, node) for name in getattr(self, each.name))
                for each in fields(self)
            )
        )


def absolute_name(name: str, namespace: str, node: str = '') -> str:
    """Return the absolute name for a private, a relative or an absolute one."""
    if name.startswith('~'):
        return f'{node}{name[1:]}'
    return name if name.startswith('/') else f'{namespace}/{name}'


def _services(node: str, *names: str) -> frozenset[str]:
    return frozenset(f'{node}/{name}' for name in names)


def _watched(*nodes: str) -> frozenset[str]:
    """Return the topics by which a node is known to be alive."""
    return frozenset(f'{node}/{topic}' for node in nodes for topic in ('_heartbeat', '_status'))


PLAIN_NODE: Final = Interfaces(
    publishes=frozenset({'/parameter_events', '/rosout'}),
    subscribes=frozenset({'/clock'}),
    serves=frozenset({'~/get_type_description'}),
)
"""A node without parameter services, such as a command's."""

ROS_NODE: Final = PLAIN_NODE | Interfaces(serves=_services('~', *PARAMETER_SERVICES))
"""A node as rclpy makes it by default."""

DYKNOW_NODE: Final = ROS_NODE | Interfaces(
    publishes=_watched('~') | {'~/_pulse'}, subscribes=frozenset({'~/_heartbeat'})
)
"""Any node with the base class `DyKnowNode`."""

START: Final = PLAIN_NODE | Interfaces(
    subscribes=frozenset(f'{node}/_status' for node in (*SERVICES, RECORDER))
)
"""`dyknow up`, which shows how the seven nodes have started."""

WATCH_FEDERATION: Final = Interfaces(subscribes=frozenset({f'{FEDERATION}/_status'}))
"""`dyknow up` of a host with peers."""

FEDERATION_HEALTH: Final = Interfaces(subscribes=_watched(FEDERATION))
"""The live page of a host with peers."""

SHOW_FEDERATION: Final = Interfaces(subscribes=frozenset({f'{FEDERATION}/federation'}))
"""The command `dyknow federation`."""

MONITOR: Final = Interfaces(
    subscribes=_watched(COORDINATOR), calls=_services(COORDINATOR, 'monitor_formula')
)
"""`FormulaClient.monitor`."""

CLIENT: Final = MONITOR | Interfaces(
    subscribes=frozenset({f'{COORDINATOR}/verdicts/*'}),
    requests=_services(COORDINATOR, 'evaluate_formula', 'report_plan_action'),
    calls=_services(COORDINATOR, *ACTIONS),
)
"""`FormulaClient`: asks for verdicts, reads the verdict topics, and changes nothing."""

MONITOR_COMMAND: Final = ROS_NODE | Interfaces(subscribes=frozenset({f'{COORDINATOR}/evaluations'}))
"""`dyknow monitor`, which looks for another monitor of its formulas."""

MARKERS: Final = Interfaces(
    publishes=frozenset({'~/markers'}),
    subscribes=_watched(COORDINATOR) | {f'{COORDINATOR}/evaluations'},
)
"""`formula_markers`, which subscribes to the odometry of its vehicles too."""

COMMANDS: Final = MONITOR | Interfaces(
    subscribes=frozenset({f'{COORDINATOR}/evaluations', 'stream_manager/streams'}),
    requests=frozenset(
        {
            'ontology_manager/ontology_query',
            'stream_semantics_manager/list_semantic_specifications',
        }
    ),
)
"""The commands `dyknow evaluate`, `evaluations`, `streams` and `semantics`."""


def engine_interfaces(
    engine: str, engines: Collection[str], topics: Collection[str], outputs: Collection[str]
) -> Interfaces:
    """Return the interfaces of a stream processing engine.

    Args:
        engine: its absolute name.
        engines: the names of all engines of the system.
        topics: the topics that streams are made from.
        outputs: the topics that sinks name for their messages.
    """
    others = [each for each in engines if each != engine]
    return DYKNOW_NODE | Interfaces(
        publishes=frozenset({'~/streams', streams_of(engine), *outputs}),
        subscribes=frozenset(topics)
        | frozenset(map(streams_of, others))
        | frozenset(f'{each}/_heartbeat' for each in others),
        serves=_services('~', *SERVICES[ENGINE]),
    )


def recorder_interfaces(
    topics: Collection[str], engines: Collection[str], snapshots: Collection[str]
) -> Interfaces:
    """Return the interfaces of the recorder of black boxes, which reads topics of any kind.

    Args:
        topics: the topics that streams are made from, or that formulas record.
        engines: the absolute names of the engines.
        snapshots: the services of recorders of rosbag2 that it calls.
    """
    return DYKNOW_NODE | Interfaces(
        publishes=frozenset({'~/black_boxes', '/diagnostics'}),
        subscribes=_watched('ontology_manager')
        | frozenset(topics)
        | frozenset(map(streams_of, engines))
        | {f'{COORDINATOR}/evaluations', f'{COORDINATOR}/verdicts/*', 'stream_manager/streams'},
        serves=frozenset(f'~/{service}' for service in RECORDER_SERVICES),
        requests=_services('ontology_manager', 'concept_get_instances', 'ontology_query')
        | frozenset(snapshots),
    )


def federation_interfaces(engines: Collection[str]) -> Interfaces:
    """Return the interfaces of the federation, which passes streams on between hosts.

    Args:
        engines: the absolute names of the engines.
    """
    watched = ('ontology_manager', 'stream_semantics_manager', 'stream_manager')
    return (
        DYKNOW_NODE
        | MONITOR
        | Interfaces(
            publishes=frozenset({'~/federation', '~/_waits', REMOTE_STREAMS}),
            serves=frozenset({'~/push_down'}),
            subscribes=_watched(*watched)
            | frozenset(f'{each}/_heartbeat' for each in engines)
            | frozenset(map(streams_of, engines))
            | {'stream_manager/streams'},
            requests=_services('stream_manager', 'stream_create_from_spec', 'stream_destroy')
            | _services(
                'ontology_manager',
                'concept_create',
                'instance_create',
                'instance_destroy',
                'ontology_query',
            )
            | _services('stream_semantics_manager', *SERVICES['stream_semantics_manager']),
        )
    )


def streams_of(engine: str) -> str:
    """Return the topics of the streams of an engine, of their violations and their messages."""
    return f'{engine.rpartition("/")[0]}/dyknow/streams/*'


def guard_interfaces(engines: Collection[str], topic: str, output: str) -> Interfaces:
    """Return the interfaces of a guard.

    Args:
        engines: the absolute names of all engines.
        topic: the topic that it guards.
        output: the topic on which it passes messages on.
    """
    watched = (COORDINATOR, 'stream_reasoning_engine', 'stream_manager')
    used = Interfaces(
        publishes=frozenset({'~/status', '/diagnostics', output}),
        subscribes=_watched('ontology_manager')
        | {topic, f'{COORDINATOR}/evaluations'}
        | frozenset(f'{each}/_pulse' for each in watched)
        | frozenset(f'{each}/_heartbeat' for each in engines)
        | frozenset(map(streams_of, engines)),
        serves=_services('~', *GUARD_SERVICES),
        requests=_services('ontology_manager', 'concept_get_instances', 'ontology_query'),
    )
    return DYKNOW_NODE | MONITOR | used


def monitor_interfaces(triggers: Collection[Trigger]) -> Interfaces:
    """Return the interfaces of a monitor of formulas.

    Args:
        triggers: the triggers that it runs.
    """
    targets = {
        kind: frozenset(each.target for each in triggers if each.kind is kind)
        for kind in TriggerKind
    }
    goals = targets[TriggerKind.CANCEL_GOAL]
    used = Interfaces(
        publishes=targets[TriggerKind.PUBLISH] | ({'/diagnostics'} if triggers else set()),
        subscribes=frozenset(f'{each}/_action/status' for each in goals),
        requests=targets[TriggerKind.CALL] | {f'{each}/_action/cancel_goal' for each in goals},
        calls=targets[TriggerKind.SEND_GOAL],
    )
    return MONITOR | used


def dashboard_interfaces(
    engines: Collection[str], guards: Collection[str], positions: Collection[str]
) -> Interfaces:
    """Return the interfaces of the live page, with its buttons.

    Args:
        engines: the absolute names of the engines.
        guards: the names of the guards.
        positions: the topics whose positions maps show.
    """
    nodes = SERVICES.keys() - {ENGINE}
    used = Interfaces(
        subscribes=_watched(*nodes, *engines, RECORDER, *guards)
        | SHOW_FEDERATION.subscribes
        | frozenset(f'{each}/status' for each in guards)
        | frozenset(map(streams_of, engines))
        | {'/diagnostics', *positions},
        requests=_services(COORDINATOR, 'cancel_evaluation')
        | _services(RECORDER, *RECORDER_SERVICES),
    )
    return PLAIN_NODE | COMMANDS | used


def node_interfaces(engines: Collection[str]) -> dict[str, Interfaces]:
    """Return the interfaces of the nodes of a system but its engines, by name of the node.

    Args:
        engines: the absolute names of the engines.
    """
    streams = frozenset(map(streams_of, engines))
    used = {
        'stream_manager': Interfaces(
            publishes=frozenset({'~/streams'}),
            subscribes=_watched(*engines) | frozenset(f'{each}/streams' for each in engines),
            requests=frozenset().union(*(_services(each, *SERVICES[ENGINE]) for each in engines)),
        ),
        'ontology_manager': Interfaces(publishes=frozenset({'~/version'})),
        'stream_semantics_manager': Interfaces(
            publishes=frozenset({'~/version'}),
            subscribes=_watched('ontology_manager', 'stream_manager') | {'stream_manager/streams'},
            requests=frozenset(
                {'ontology_manager/ontology_query', 'stream_manager/stream_get_topic'}
            ),
        ),
        'semantic_matching_engine': Interfaces(
            subscribes=_watched('ontology_manager', 'stream_semantics_manager'),
            requests=COMMANDS.requests,
        ),
        'stream_reasoning_engine': Interfaces(
            publishes=frozenset({'~/episodes', '~/progress', f'{COORDINATOR}/_results_*'}),
            subscribes=streams | frozenset(f'{each}/_heartbeat' for each in engines),
        ),
        COORDINATOR: _coordinator(engines, streams),
    }
    return {
        node: DYKNOW_NODE | Interfaces(serves=_services('~', *SERVICES[node])) | each
        for node, each in used.items()
    }


def _coordinator(engines: Collection[str], streams: Collection[str]) -> Interfaces:
    of_streams = ('stream_create_from_spec', 'stream_destroy', 'stream_get_topic')
    others = SERVICES.keys() - {ENGINE, COORDINATOR}
    return Interfaces(
        publishes=frozenset({'~/evaluations', '~/ready', '~/verdicts/*', '/diagnostics'}),
        # Also of a host without peers: it looks for them.
        subscribes=_watched(*others, *engines, FEDERATION)
        | {f'{each}/violations' for each in streams}
        | {
            '~/_results_*',
            f'{FEDERATION}/_waits',
            'ontology_manager/version',
            'stream_semantics_manager/version',
            'stream_manager/streams',
            'stream_reasoning_engine/episodes',
            'stream_reasoning_engine/progress',
        },
        requests=_services('ontology_manager', 'concept_get_instances', 'ontology_query')
        | _services('semantic_matching_engine', *SERVICES['semantic_matching_engine'])
        | _services(FEDERATION, 'push_down')
        | _services('stream_reasoning_engine', *SERVICES['stream_reasoning_engine'])
        | _services('stream_manager', *of_streams),
        executes=_services('~', *ACTIONS),
    )


def administration(engines: Collection[str], others: Mapping[str, Collection[str]]) -> Interfaces:
    """Return what changes a running system: all services of its nodes, with their parameters.

    Args:
        engines: the names of the engines.
        others: the services of further nodes, by the names of the nodes.
    """
    nodes = {**SERVICES, RECORDER: RECORDER_SERVICES, **others}
    del nodes[ENGINE]
    nodes.update(dict.fromkeys(engines, SERVICES[ENGINE]))
    return Interfaces(
        requests=frozenset().union(
            *(_services(node, *names, *PARAMETER_SERVICES) for node, names in nodes.items())
        )
    )
