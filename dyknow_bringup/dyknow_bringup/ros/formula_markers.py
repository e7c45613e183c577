"""Show formulas as markers, for rviz2 and Foxglove: fences, regions, lines and texts."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any, Final

from builtin_interfaces.msg import Duration
from dyknow_interfaces.msg import EvaluationStatusArray
from geometry_msgs.msg import Point as PointMessage
from nav_msgs.msg import Odometry
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker as MarkerMessage
from visualization_msgs.msg import MarkerArray

from dyknow_bringup.errors import BringupError
from dyknow_common import SECOND_NS
from dyknow_common.ros import (
    DyKnowNode,
    RemoteNode,
    Throttle,
    run,
)
from dyknow_configuration import read_robot
from dyknow_coordinator import EvaluationStatus
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from dyknow_recordings.markers import (
    DEFAULT_AXES,
    LIFETIME_NS,
    ODOMETRY,
    PERIOD_NS,
    Axes,
    Marker,
    Point,
    formula_markers,
    objects_of,
)

WARNING_PERIOD_S = 60.0
"""Time between two warnings about vehicles in different frames."""

POSITION_AGE_NS: Final = 3 * SECOND_NS
"""The age from which on a position is not drawn any more."""

# Not latched: a late subscriber gets the next markers after a period.
MARKERS = QoSProfile(depth=1)


class FormulaMarkers(DyKnowNode):
    """Publisher of the evaluations of a coordinator on `~/markers`, while that has subscribers.

    The vehicles are the objects of the formulas' ground features that have an odometry topic.
    """

    def __init__(self) -> None:
        super().__init__('formula_markers')
        coordinator = self.parameter(
            'coordinator', 'stream_reasoning_coordinator', 'Name of the coordinator node.'
        )
        self._odometry = self.parameter('odometry', ODOMETRY, 'Topic of the odometry of a vehicle.')
        self._axes = self._checked_axes(
            self.parameter(
                'axes',
                [*DEFAULT_AXES],
                'The features that are the x, y and z of a vehicle, in the frame of its odometry.',
            )
        )
        robot = self.parameter('robot', '', 'robot.yaml whose regions are shown.')
        self._regions = read_robot(Path(robot)).map.regions if robot else ()
        self._statuses: list[EvaluationStatus] = []
        self._subscriptions_by_vehicle: dict[str, Any] = {}
        self._positions: dict[str, Point] = {}
        self._received_at: dict[str, int] = {}
        self._frame = ''
        self._frame_warning = Throttle(WARNING_PERIOD_S)
        self.create_report_subscription(
            EvaluationStatusArray, f'{coordinator}/evaluations', self._on_evaluations
        )
        RemoteNode(self, coordinator).on_lost.append(self._forget)
        self._markers = self.create_publisher(MarkerArray, '~/markers', MARKERS)
        self.create_timer(PERIOD_NS / SECOND_NS, self._publish_markers, clock=self.wall_clock)

    def _checked_axes(self, axes: Any) -> Axes:
        try:
            x, y, z = axes
        except ValueError:
            raise BringupError(
                f'axes are {len(axes)} features ({", ".join(axes)}); name three, for x, y and z'
            ) from None
        return x, y, z

    def _on_evaluations(self, report: Any) -> None:
        self._statuses = [status_from_message(each) for each in report.evaluations]

    def _forget(self) -> None:
        """Show no evaluation of a coordinator that does not answer any more."""
        self._statuses = []

    def _publish_markers(self) -> None:
        watched = self._markers.get_subscription_count() > 0
        vehicles = {name for each in self._statuses for name in objects_of(each.groundings)}
        vehicles -= {each.name for each in self._regions}
        # Odometry costs most: do not subscribe to it without a viewer.
        self._subscribe_to(vehicles if watched else ())
        if watched and self._frame:
            drawn = formula_markers(
                self._statuses,
                self._positions,
                self._axes,
                self.now(),
                self._regions,
                self._frame,
            )
            self._markers.publish(MarkerArray(markers=[self._message(each) for each in drawn]))

    def _subscribe_to(self, vehicles: Collection[str]) -> None:
        for vehicle in self._subscriptions_by_vehicle.keys() - set(vehicles):
            subscription = self._subscriptions_by_vehicle.pop(vehicle)
            self._positions.pop(vehicle, None)
            if subscription is not None:
                self.destroy_subscription(subscription)
        for vehicle in vehicles:
            if vehicle not in self._subscriptions_by_vehicle:
                self._subscriptions_by_vehicle[vehicle] = self._subscription(vehicle)
        now = self.now()
        # A vehicle may be elsewhere since; simulated time may have been set back.
        for vehicle in [*self._positions]:
            if not 0 <= now - self._received_at[vehicle] <= POSITION_AGE_NS:
                del self._positions[vehicle]
        if not self._positions:
            self._frame = ''

    def _subscription(self, vehicle: str) -> Any:
        try:
            return self.create_subscription(
                Odometry,
                self._odometry.replace('<vehicle>', vehicle),
                partial(self._on_odometry, vehicle),
                qos_profile_sensor_data,
            )
        except InvalidTopicNameException as error:
            self.get_logger().warning(f'{vehicle} is not shown: {error}')
            return None

    def _on_odometry(self, vehicle: str, odometry: Any) -> None:
        self._frame = self._frame or odometry.header.frame_id
        if odometry.header.frame_id != self._frame:
            if self._frame_warning.is_due():
                self.get_logger().warning(
                    f'{vehicle} is not shown: its odometry is in the frame '
                    f"'{odometry.header.frame_id}', and that of the others in '{self._frame}'; "
                    'have them use the same'
                )
            return
        position = odometry.pose.pose.position
        self._positions[vehicle] = (position.x, position.y, position.z)
        self._received_at[vehicle] = self.now()

    def _message(self, marker: Marker) -> MarkerMessage:
        red, green, blue, opacity = marker.colour
        message = MarkerMessage(
            ns=marker.name,
            id=marker.number,
            type=int(marker.shape),
            action=MarkerMessage.ADD,
            color=ColorRGBA(r=red, g=green, b=blue, a=opacity),
            points=[_point(point) for point in marker.points],
            text=marker.text,
            lifetime=Duration(sec=LIFETIME_NS // SECOND_NS),
        )
        message.header.frame_id = self._frame
        message.header.stamp = self.get_clock().now().to_msg()
        message.pose.position = _point(marker.position)
        message.scale.x, message.scale.y, message.scale.z = marker.scale
        return message


def _point(point: Point) -> PointMessage:
    x, y, z = point
    return PointMessage(x=x, y=y, z=z)


def main() -> int:
    """Run the executable formula_markers."""
    return run(FormulaMarkers)
