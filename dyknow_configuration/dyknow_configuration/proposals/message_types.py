"""Features that messages of well-known types carry."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from dyknow_common import ValueType, field_type, listed_as

MAX_ELEMENTS: Final = 32
"""The number of elements of an array, such as joints, that are looked at."""

MAGNITUDE: Final = 'always abs({feature}) < {magnitude}'
LEAST: Final = 'always {feature} > {least}'


@dataclass(frozen=True, slots=True)
class FeatureProposal:
    """A feature that a field of a message can carry.

    Args:
        name: the name of the feature; empty for the name of the topic.
        field: its path, with `{}` for a number or a name if there is an object for each element.
        unit: the unit of the values; empty for none.
        description: for people.
        formula: a formula that can be expected to hold; `{feature}` stands for the feature,
            `{magnitude}` and `{least}` for bounds from the values seen. Empty if none is plausible.
        value_type: the value type of the values.
        elements: the parallel array of names; empty if the field is a single value.
        element_sort: the sort of what these names name.
    """

    name: str
    field: str
    unit: str = ''
    description: str = ''
    formula: str = ''
    value_type: ValueType = ValueType.FLOAT
    elements: str = ''
    element_sort: str = ''

    @property
    def read_fields(self) -> tuple[str, ...]:
        """The fields of a message that say which values this feature has."""
        if not self.elements:
            return (self.field,)
        return tuple(
            f'{array}[{index}]' for array in (self.array, self.elements) for index in _INDEXES
        )

    @property
    def array(self) -> str:
        """The array of a field that has an object for each element."""
        return self.field.partition('[')[0]


_INDEXES: Final = range(MAX_ELEMENTS)
_P = FeatureProposal

_SPEED = 'Speed, forwards.'
_CHARGE = 'How full the battery is, from 0 to 1.'

_PROPOSALS: Final[Mapping[str, tuple[FeatureProposal, ...]]] = {
    'nav_msgs/msg/Odometry': (
        _P('Speed', 'twist.twist.linear.x', 'm/s', _SPEED, MAGNITUDE),
        _P('TurnRate', 'twist.twist.angular.z', 'rad/s', 'Turn rate, to the left.', MAGNITUDE),
        _P('Height', 'pose.pose.position.z', 'm', 'Height in the frame of the odometry.'),
    ),
    'geometry_msgs/msg/PoseStamped': (
        _P('Height', 'pose.position.z', 'm', 'Height in the frame of the pose.'),
    ),
    'geometry_msgs/msg/PoseWithCovarianceStamped': (
        _P('Height', 'pose.pose.position.z', 'm', 'Height in the frame of the pose.'),
    ),
    'geometry_msgs/msg/Twist': (
        _P('CommandedSpeed', 'linear.x', 'm/s', 'Commanded speed, forwards.', MAGNITUDE),
    ),
    'geometry_msgs/msg/TwistStamped': (
        _P('CommandedSpeed', 'twist.linear.x', 'm/s', 'Commanded speed, forwards.', MAGNITUDE),
    ),
    'sensor_msgs/msg/BatteryState': (
        _P('Charge', 'percentage', '', _CHARGE, LEAST),
        _P('Voltage', 'voltage', 'V', 'Voltage of the battery.', LEAST),
        _P('Current', 'current', 'A', 'Current of the battery; negative if it discharges.'),
    ),
    'sensor_msgs/msg/LaserScan': (
        _P('Clearance', 'min(ranges)', 'm', 'Distance of the nearest obstacle.', LEAST),
    ),
    'sensor_msgs/msg/Range': (
        _P('Distance', 'range', 'm', 'Distance of the obstacle ahead of the sensor.', LEAST),
    ),
    'sensor_msgs/msg/Imu': (
        _P('YawRate', 'angular_velocity.z', 'rad/s', 'Turn rate about the z axis.', MAGNITUDE),
        _P('Acceleration', 'linear_acceleration.x', 'm/s^2', 'Acceleration, forwards.', MAGNITUDE),
    ),
    'sensor_msgs/msg/NavSatFix': (
        _P(
            'FixStatus',
            'status.status',
            '',
            'At least 0 if the receiver has a fix.',
            'always {feature} >= 0',
            ValueType.INT,
        ),
        _P('GpsAltitude', 'altitude', 'm', 'Height above the ellipsoid.'),
    ),
    'sensor_msgs/msg/JointState': (
        _P(
            'JointPosition',
            'position[name = "{}"]',
            'rad',
            'Angle of a joint.',
            MAGNITUDE,
            elements='name',
            element_sort='Joint',
        ),
    ),
    'sensor_msgs/msg/Temperature': (
        _P('Temperature', 'temperature', 'degC', 'Temperature.', MAGNITUDE),
    ),
    'diagnostic_msgs/msg/DiagnosticArray': (
        _P(
            'DiagnosticLevel',
            'max(status.level)',
            '',
            'Worst level of a message, 0 is OK, 1 WARN, 2 ERROR, 3 STALE; DyKnow sends some, too: '
            'status[name = "NAME"].level is the level of one part.',
            # A formula over it would be false as soon as DyKnow reports another one that is false.
            value_type=ValueType.INT,
        ),
    ),
    'std_msgs/msg/Bool': (_P('', 'data', value_type=ValueType.BOOLEAN),),
    **{
        f'std_msgs/msg/{kind}': (_P('', 'data', formula=MAGNITUDE, value_type=type_),)
        for kind, type_ in (
            ('Float32', ValueType.FLOAT),
            ('Float64', ValueType.FLOAT),
            ('Int32', ValueType.INT),
            ('UInt32', ValueType.INT),
        )
    },
    'mavros_msgs/msg/State': (
        _P(
            'Connected',
            'connected',
            '',
            'True if the autopilot answers.',
            'always {feature}',
            ValueType.BOOLEAN,
        ),
        _P('Armed', 'armed', '', 'True if the motors may run.', '', ValueType.BOOLEAN),
        _P('Mode', 'mode', '', 'Mode of the autopilot.', '', ValueType.STRING),
    ),
    'mavros_msgs/msg/VfrHud': (
        _P('GroundSpeed', 'groundspeed', 'm/s', 'Speed over ground.', MAGNITUDE),
        _P('ClimbRate', 'climb', 'm/s', 'Speed upwards.', MAGNITUDE),
    ),
    'px4_msgs/msg/BatteryStatus': (
        _P('Charge', 'remaining', '', _CHARGE, LEAST),
        _P('Voltage', 'voltage_v', 'V', 'Voltage of the battery.', LEAST),
    ),
    'px4_msgs/msg/VehicleLocalPosition': (
        _P('Descent', 'vz', 'm/s', 'Speed downwards.', MAGNITUDE),
        _P('NorthSpeed', 'vx', 'm/s', 'Speed to the north.', MAGNITUDE),
        _P('EastSpeed', 'vy', 'm/s', 'Speed to the east.', MAGNITUDE),
        _P('Depth', 'z', 'm', 'Position downwards; negative above the start.'),
    ),
    'px4_msgs/msg/VehicleGlobalPosition': (_P('GpsAltitude', 'alt', 'm', 'Height above the sea.'),),
    'px4_msgs/msg/VehicleStatus': (
        _P(
            'Failsafe',
            'failsafe',
            '',
            'True if the autopilot has taken over.',
            'always not {feature}',
            ValueType.BOOLEAN,
        ),
        _P('ArmingState', 'arming_state', '', '2 if the motors may run.', '', ValueType.INT),
    ),
    'px4_msgs/msg/VehicleLandDetected': (
        _P('Landed', 'landed', '', 'True on the ground.', '', ValueType.BOOLEAN),
    ),
    'px4_msgs/msg/SensorGps': (
        _P(
            'Satellites',
            'satellites_used',
            '',
            'Number of satellites in use.',
            LEAST,
            ValueType.INT,
        ),
    ),
}
_SAME_AS: Final = {'vehicle_gps_position': 'SensorGps'}


def proposals_of(
    message_type: str, fields: Mapping[str, ValueType] | None
) -> Iterator[FeatureProposal]:
    """Yield the features that messages of a type can carry.

    Args:
        message_type: such as `nav_msgs/msg/Odometry`; `px4/battery_status` for logs of PX4.
        fields: the fields of the messages; None if they are not known.
    """
    package, _, name = message_type.rpartition('/')
    if package == 'px4':
        words = _SAME_AS.get(name) or ''.join(each.capitalize() for each in name.split('_'))
        message_type = f'px4_msgs/msg/{words}'
    for each in _PROPOSALS.get(message_type, ()) if fields is not None else ():
        # Versions of a message type differ.
        path = f'{each.array}[0]' if each.elements else each.field
        found = field_type(fields, path) if fields and listed_as(fields, path) else None
        if found is not None and each.value_type.accepts(found):
            yield each


def camel_case(text: str) -> str:
    """Return the words of a name of a topic as a name of a feature: `cmd_vel` is `CmdVel`."""
    words = re.findall(r'[A-Za-z0-9]+', text, re.ASCII)
    return ''.join(each[0].upper() + each[1:] for each in words)
