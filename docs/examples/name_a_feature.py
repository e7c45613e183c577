"""Create a sort, an object and a feature, annotate a topic, and evaluate a formula over them.

It needs `dyknow up`, and a publisher of the topic:

ros2 topic pub -r 10 /boat1/draught std_msgs/msg/Float64 '{data: 120.0}'
"""

import sys

import rclpy
from dyknow_interfaces.msg import ExitStatus
from dyknow_interfaces.srv import AddSemanticSpecification, ConceptCreate, InstanceCreate
from rclpy.node import Node

from dyknow_common import DyKnowError
from dyknow_coordinator.ros import FormulaClient

FORMULA = 'forall b in Boat: always[0 s, 1 s] Draught[b] < 2.5'


def request(node, service_type, service, **fields):
    """Call a service; raise a RuntimeError if it refuses, unless the thing exists already."""
    client = node.create_client(service_type, service)
    if not client.wait_for_service(timeout_sec=20.0):
        raise RuntimeError(f'{service} is not available; is DyKnow running?')
    future = client.call_async(service_type.Request(**fields))
    rclpy.spin_until_future_complete(node, future, timeout_sec=20.0)
    if not future.done():
        raise RuntimeError(f'{service} does not answer')
    status = future.result().exit_status
    if status.code not in {ExitStatus.SUCCESS, ExitStatus.ALREADY_EXISTS}:
        raise RuntimeError(status.message)


def main():
    rclpy.init()
    node = Node('harbour')
    create_concept = 'ontology_manager/concept_create'
    request(node, ConceptCreate, create_concept, concept_name='Boat')
    request(
        node,
        InstanceCreate,
        'ontology_manager/instance_create',
        instance_name='boat1',
        concept_names=['Boat'],
    )
    request(
        node,
        ConceptCreate,
        create_concept,
        concept_name='Draught',
        argument_sorts=['Boat'],
        value_type='float',
        unit='m',
    )
    request(
        node,
        AddSemanticSpecification,
        'stream_semantics_manager/add_semantic_specification',
        ssl_statement='stream "/boat1/draught" contains Draught[boat1] = data [cm]',
    )
    with FormulaClient(node) as client:
        answer = client.evaluate_blocking(FORMULA, timeout=30.0, wait=30.0)
    node.get_logger().info(f'{answer.check().verdict.name} {answer.explanation}')
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    try:
        main()
    except (DyKnowError, RuntimeError) as error:
        sys.exit(f'name_a_feature: {error}')
