"""Bare rclpy nodes that relay messages like the nodes of DyKnow.

python benchmarks/relays.py samples|verdicts|answers    a process for each of them
python benchmarks/relays.py all_in_one                  one node that answers at the message itself
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from dyknow_interfaces.msg import Field, FormulaResult, Sample
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float64

from dyknow_common.ros import STREAM

PROGRAM = Path(__file__)
SERVICE_NAME = '/relayed/evaluate_formula'
LIMIT = 5.0
"""The smallest level that makes the formula false."""


def samples(node: Node) -> None:
    """Convert messages of the robots to samples, like the stream processing engine."""
    publisher = node.create_publisher(Sample, '/relayed/samples', STREAM)

    def publish(value: float) -> None:
        now = node.get_clock().now().to_msg()
        sample = Sample(valid_time=now, available_time=now)
        sample.fields = [Field(type='float', name='level', value=repr(value))]
        publisher.publish(sample)

    node.create_subscription(Float64, '/robot/level', lambda each: publish(each.data), STREAM)
    node.create_subscription(
        BatteryState, '/uav1/battery', lambda each: publish(each.current), STREAM
    )


def verdicts(node: Node) -> None:
    """Convert samples to results, like the stream reasoning engine."""
    publisher = node.create_publisher(FormulaResult, '/relayed/results', STREAM)

    def on_sample(sample: Any) -> None:
        value = float(sample.fields[0].value)
        if value >= LIMIT:
            result = FormulaResult(verdict=FormulaResult.FALSE, decided_at=sample.valid_time)
            result.explanation = f'false because level = {value}'
            publisher.publish(result)

    node.create_subscription(Sample, '/relayed/samples', on_sample, STREAM)


def answers(node: Node) -> None:
    """Answer service calls with the next result, like the stream reasoning coordinator."""
    group = ReentrantCallbackGroup()
    waiting: list[Future] = []

    async def evaluate(_request: Any, response: Any) -> Any:
        future: Future = Future()
        waiting.append(future)
        result = await future
        response.verdict, response.decided_at = result.verdict, result.decided_at
        response.explanation = result.explanation
        return response

    def on_result(result: Any) -> None:
        while waiting:
            waiting.pop().set_result(result)

    node.create_service(EvaluateFormula, SERVICE_NAME, evaluate, callback_group=group)
    node.create_subscription(
        FormulaResult, '/relayed/results', on_result, STREAM, callback_group=group
    )


def all_in_one(node: Node) -> None:
    """Answer service calls at the message that makes the formula false.

    These are the two hops that no process can avoid: from the robot, and to the caller.
    """
    group = ReentrantCallbackGroup()
    waiting: list[Future] = []

    async def evaluate(_request: Any, response: Any) -> Any:
        future: Future = Future()
        waiting.append(future)
        response.verdict, response.decided_at = FormulaResult.FALSE, await future
        return response

    def on_level(value: float) -> None:
        while value >= LIMIT and waiting:
            waiting.pop().set_result(node.get_clock().now().to_msg())

    node.create_service(EvaluateFormula, SERVICE_NAME, evaluate, callback_group=group)
    node.create_subscription(
        Float64, '/robot/level', lambda each: on_level(each.data), STREAM, callback_group=group
    )
    node.create_subscription(
        BatteryState,
        '/uav1/battery',
        lambda each: on_level(each.current),
        STREAM,
        callback_group=group,
    )


CHAIN = (samples, verdicts, answers)
ROLES = {each.__name__: each for each in (*CHAIN, all_in_one)}


def main() -> None:
    """Relay messages until the process is killed."""
    rclpy.init()
    node = rclpy.create_node(f'relay_{sys.argv[1]}')
    ROLES[sys.argv[1]](node)
    print('begun', flush=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
