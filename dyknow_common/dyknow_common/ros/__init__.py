"""The parts that every ROS node of DyKnow shares."""

from dyknow_common.ros.background import Background
from dyknow_common.ros.below_rclpy.direct_topics import DirectPublisher, DirectSubscription
from dyknow_common.ros.below_rclpy.executor import (
    NodeExecutor,
    node_executor,
    supports_node_executor,
)
from dyknow_common.ros.below_rclpy.senders import GID, full_name
from dyknow_common.ros.callback_groups import PrunedCallbackGroup
from dyknow_common.ros.commands import (
    CommandNode,
    command_main,
    ros_errors,
    run_chosen,
    run_ros_main,
    run_with_node,
    start_ros,
)
from dyknow_common.ros.dataclass_messages import from_message, to_message
from dyknow_common.ros.deadlines import REST_PERIOD_S, TICK_PERIOD_S, set_period
from dyknow_common.ros.diagnostics import DiagnosticsPublisher
from dyknow_common.ros.guards import (
    MessageGuard,
    Refusal,
    only_from,
    only_owner,
    only_publishers_of,
)
from dyknow_common.ros.liveliness import Heartbeats, PublisherWatch, TopicOwner
from dyknow_common.ros.node import (
    NODE_TYPE,
    RUNNING,
    STARTED_AT,
    DyKnowNode,
    is_time_simulated,
    snake_case,
    started_at,
)
from dyknow_common.ros.parameter_limits import ParameterLimits
from dyknow_common.ros.process import run
from dyknow_common.ros.qos import (
    HEARTBEAT,
    LATCHED,
    LATCHED_HISTORY,
    NO_SUBSCRIPTION_EVENTS,
    REPORTS,
    SERVICE,
    STATUS,
    STREAM,
    VIOLATIONS,
)
from dyknow_common.ros.remote_node import LONG_TIMEOUT_S, NodeAdapter, RemoteNode
from dyknow_common.ros.report_command import ReportCommand, add_report_options
from dyknow_common.ros.throttle import LogOnce, Throttle
from dyknow_common.ros.time_messages import (
    constraints_from_message,
    constraints_to_message,
    error_from_message,
    error_to_message,
    identities_from_message,
    identities_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_common.ros.topic_names import RCLError, absolute_topic, topic_fault

__all__ = [
    'GID',
    'HEARTBEAT',
    'LATCHED',
    'LATCHED_HISTORY',
    'LONG_TIMEOUT_S',
    'NODE_TYPE',
    'NO_SUBSCRIPTION_EVENTS',
    'REPORTS',
    'REST_PERIOD_S',
    'RUNNING',
    'SERVICE',
    'STARTED_AT',
    'STATUS',
    'STREAM',
    'TICK_PERIOD_S',
    'VIOLATIONS',
    'Background',
    'CommandNode',
    'DiagnosticsPublisher',
    'DirectPublisher',
    'DirectSubscription',
    'DyKnowNode',
    'Heartbeats',
    'LogOnce',
    'MessageGuard',
    'NodeAdapter',
    'NodeExecutor',
    'ParameterLimits',
    'PrunedCallbackGroup',
    'PublisherWatch',
    'RCLError',
    'Refusal',
    'RemoteNode',
    'ReportCommand',
    'Throttle',
    'TopicOwner',
    'absolute_topic',
    'add_report_options',
    'command_main',
    'constraints_from_message',
    'constraints_to_message',
    'error_from_message',
    'error_to_message',
    'from_message',
    'full_name',
    'identities_from_message',
    'identities_to_message',
    'is_time_simulated',
    'nanoseconds_to_duration',
    'nanoseconds_to_time',
    'node_executor',
    'only_from',
    'only_owner',
    'only_publishers_of',
    'ros_errors',
    'run',
    'run_chosen',
    'run_ros_main',
    'run_with_node',
    'set_period',
    'snake_case',
    'start_ros',
    'started_at',
    'supports_node_executor',
    'time_to_nanoseconds',
    'to_message',
    'topic_fault',
]
