"""The page of the nodes: their services, actions, topics and parameters.

The nodes are made, but not run, where they cannot meet others.
"""

import os
import sys
from inspect import getdoc

import rclpy
from rclpy.action import get_action_server_names_and_types_by_node
from rclpy.node import Node
from rclpy.parameter import Parameter
from reference.interfaces import link
from reference.markdown import code, listed, page, table

from dyknow_bringup.ros.formula_markers import FormulaMarkers
from dyknow_bringup.security.interfaces import DYKNOW_NODE, engine_interfaces, node_interfaces
from dyknow_common.ros import DyKnowNode
from dyknow_coordinator.ros.stream_reasoning_coordinator import StreamReasoningCoordinator
from dyknow_reactions.ros.black_box.black_box_recorder import BlackBoxRecorder
from dyknow_reasoning.ros.stream_reasoning_engine import StreamReasoningEngine
from dyknow_semantics.ros.ontology_manager import OntologyManager
from dyknow_semantics.ros.semantic_matching_engine import SemanticMatchingEngine
from dyknow_semantics.ros.stream_semantics_manager import StreamSemanticsManager
from dyknow_stream_processing.ros.stream_manager import StreamManager
from dyknow_stream_processing.ros.stream_processing_engine import StreamProcessingEngine

NODES = (
    StreamReasoningCoordinator,
    StreamReasoningEngine,
    StreamManager,
    StreamProcessingEngine,
    OntologyManager,
    StreamSemanticsManager,
    SemanticMatchingEngine,
    FormulaMarkers,
    BlackBoxRecorder,
)

ENGINE = 'stream_processing_engine'
SAMPLE, VIOLATION = 'dyknow_interfaces/msg/Sample', 'dyknow_interfaces/msg/ConstraintViolation'

INTRODUCTION = """\
The seven nodes of DyKnow, `formula_markers` and `black_box_recorder`. Names that begin with `~/`
are within the name of the node: `~/evaluate_formula` of the coordinator is
`/stream_reasoning_coordinator/evaluate_formula`. In names, `*` stands for any text. Parameters come
from a params file, the `nodes` of a [robot.yaml](../configuration.md), or, with
`ros2 run`, `--ros-args -p NAME:=VALUE`; [Commands](commands.md) names the verbs that take it. `ros2
param set` changes some while the node runs. [Limits](../limits.md) explains the bounds of what a
request may cost."""

EVERY_NODE = """\
Every node publishes `~/_heartbeat` ([`Heartbeat`](interfaces.md#heartbeat)), by which others know
that it is alive, and the latched `~/_status` (`diagnostic_msgs/msg/DiagnosticStatus`): what it has
loaded, what it has dropped, and what it lacks. It has the services and parameters of any rclpy
node, such as `use_sim_time`, and these:"""

OF_MANY_TOPICS = {
    '/dyknow/streams/*': f'{link(SAMPLE)}; of violations, {link(VIOLATION)}',
    'stream_reasoning_coordinator/results_*': link('dyknow_interfaces/msg/FormulaResult'),
}
"""The types of topics that are made for single streams and formulas."""

PARTS = {
    'services': ('service', 'type'),
    'actions': ('action', 'type'),
    'topics that it publishes': ('topic', 'type'),
}


def nodes_page():
    """Return the page."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'OFF'
    rclpy.init()
    try:
        plain, common = _described(Node('plain_node')), _described(DyKnowNode('any_node'))
        used = {**node_interfaces([ENGINE]), ENGINE: engine_interfaces(ENGINE, [ENGINE], (), ())}
        nodes = [make() for make in NODES]
        if missing := used.keys() - {each.get_name() for each in nodes}:
            raise LookupError(f'NODES lacks {", ".join(sorted(missing))}')
        parts = [_section(each, common, used) for each in nodes]
    finally:
        rclpy.try_shutdown()
    return page('Nodes', INTRODUCTION, _common(common, plain), *parts)


def _described(node):
    """Return what a node has by now, by kind: types by name, and rows of parameters."""
    name, namespace = node.get_name(), node.get_namespace()
    private = f'{node.get_fully_qualified_name()}/'

    def rows(items):
        shown = {item.replace(private, '~/'): link(types[0]) for item, types in items}
        return {item: text for item, text in shown.items() if '/_action/' not in item}

    described = {
        'services': rows(node.get_service_names_and_types_by_node(name, namespace)),
        'actions': rows(get_action_server_names_and_types_by_node(node, name, namespace)),
        'topics that it publishes': rows(
            node.get_publisher_names_and_types_by_node(name, namespace)
        ),
        'parameters': {each: _parameter(node, each) for each in node._parameters},  # noqa: SLF001
    }
    node.destroy_node()
    return described


def _parameter(node, name):
    descriptor, value = node.describe_parameter(name), node.get_parameter(name)
    bounds = [
        f'({each.from_value:.12g} to {each.to_value:.12g})'
        for each in (*descriptor.integer_range, *descriptor.floating_point_range)
    ]
    text = ' '.join(filter(None, (descriptor.description, *bounds)))
    return _default(value), 'no' if descriptor.read_only else 'yes', text


def _default(parameter):
    if parameter.type_ is Parameter.Type.BOOL:
        return code(str(parameter.value).lower())
    if parameter.type_ is Parameter.Type.STRING_ARRAY:
        return listed(filter(None, parameter.value)) or code('[]')
    return code(str(parameter.value))


def _common(common, plain):
    own = common['parameters'].keys() - plain['parameters'].keys()
    rows = [(code(name), *common['parameters'][name]) for name in sorted(own)]
    return '\n\n'.join(
        (
            '## Every node',
            EVERY_NODE,
            table(('parameter', 'default', 'can change', ''), rows),
        )
    )


def _section(node, common, used):
    name = node.get_name()
    described = _described(node)
    parts = [f'## {name}', _summary(type(node))]
    interfaces = used.get(name)
    for kind, head in PARTS.items():
        rows = {each: text for each, text in described[kind].items() if each not in common[kind]}
        if kind.startswith('topics') and interfaces is not None:
            hidden = interfaces.publishes - DYKNOW_NODE.publishes
            rows |= {each: OF_MANY_TOPICS.get(each, '') for each in hidden if each not in rows}
        parts.append(table(head, [(code(each), rows[each]) for each in sorted(rows)]))
    if interfaces is not None:
        subscribed = sorted(interfaces.subscribes - DYKNOW_NODE.subscribes)
        parts.append(f'It subscribes to {listed(subscribed)}.' if subscribed else '')
    own = described['parameters'].keys() - common['parameters'].keys()
    rows = [(code(each), *described['parameters'][each]) for each in sorted(own)]
    parts.append(table(('parameter', 'default', 'can change', ''), rows))
    return '\n\n'.join(filter(None, parts))


def _summary(node_class):
    module = sys.modules[node_class.__module__]
    text = getdoc(module).split('\n\n')[0].split(' (')[0].rstrip('.')
    return ' '.join(text.split()) + '.'
