"""Simulate a fleet, which publishes `uavN/odometry` and `uavN/battery` as real vehicles do."""

from __future__ import annotations

from typing import Any

from dyknow_bringup.resources import scenario_path
from dyknow_bringup.simulation.scenario import load_scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.telemetry import MESSAGE_TYPES, Channel, ros_message, topic
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common.ros import DyKnowNode, run
from dyknow_stream_processing.ros import message_class

DEPTH = 100
"""Number of messages that a publisher keeps for slow subscribers."""


class UavSimulation(DyKnowNode):
    """Simulation of a scenario in real time, by the ROS clock."""

    def __init__(self) -> None:
        super().__init__('uav_simulation')
        scenario = self.parameter(
            'scenario', 'nominal', 'Name of a shipped scenario, or path of a YAML file.'
        )
        vehicles = self.parameter('uavs', 3, 'Number of vehicles: uav1, uav2, ...', (1, 100))
        rate = self.parameter(
            'update_rate', 200.0, 'Rate at which due messages are published, Hz.', (10.0, 1000.0)
        )
        self._vehicles = vehicle_names(vehicles)
        self._scenario = load_scenario(scenario_path(scenario))
        self._scenario.check_fleet(self._vehicles)
        self._outputs = {
            (vehicle, channel): self.create_publisher(
                message_class(MESSAGE_TYPES[channel]), topic(vehicle, channel), DEPTH
            )
            for vehicle in self._vehicles
            for channel in Channel
        }
        self._simulation: Simulation | None = None
        self.create_timer(1.0 / rate, self._publish_due)

    def _publish_due(self) -> None:
        now = self.now()
        if now == 0:
            return  # Simulated time has not begun.
        if self._simulation is None:
            self._simulation = Simulation(self._scenario, self._vehicles, now)
            self.set_status('flying', {'scenario': self._scenario.name, 'start_time': str(now)})
            self.get_logger().info(f'{self._scenario.name}: {self._scenario.description}')
        for message in self._simulation.until(now):
            publisher: Any = self._outputs[message.vehicle, message.channel]
            publisher.publish(ros_message(message, message_class))


def main() -> int:
    """Run the executable uav_simulation."""
    return run(UavSimulation)
