"""Simulation of a fleet: the same telemetry for the same seed, live or recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from typing import Final

import numpy as np

from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.telemetry import TRANSPORT, Sensors, Telemetry
from dyknow_bringup.simulation.vehicle import Vehicle
from dyknow_common import NANOSECONDS, SECOND_NS

STEP_NS: Final = 25 * NANOSECONDS['ms']
"""The step of the physics; every period of telemetry is a multiple of it."""


class Simulation:
    """A fleet that flies a scenario.

    The telemetry depends on the scenario, the vehicles and the start only, not on the calls of
    `until`. The noise of a vehicle does not depend on the number of vehicles.

    Args:
        scenario: flights and disturbances.
        vehicles: the names of the vehicles, in the order of their lanes.
        start: the time of the first stamp, in nanoseconds.

    Raises:
        BringupError: if the scenario needs a vehicle that the fleet lacks.
    """

    def __init__(self, scenario: Scenario, vehicles: Sequence[str], start: int) -> None:
        scenario.check_fleet(vehicles)
        self._scenario = scenario
        self._start = start
        self._elapsed = 0
        self._vehicles: dict[str, Vehicle] = {}
        self._sensors: dict[str, Sensors] = {}
        self._under_way: list[tuple[int, int, Telemetry]] = []
        self._sent = 0
        for lane, name in enumerate(vehicles):
            vehicle = Vehicle(scenario.plan(name, lane))
            noise = np.random.default_rng([scenario.seed, lane])
            self._vehicles[name] = vehicle
            self._sensors[name] = Sensors(name, vehicle, noise)
        self._measure()

    def until(self, time: int) -> Iterator[Telemetry]:
        """Yield the messages delivered since the last call, up to and including a time, in order.

        Args:
            time: in nanoseconds.
        """
        while self._start + self._elapsed + STEP_NS <= time:
            yield from self._delivered(self._start + self._elapsed)
            self._step()
        yield from self._delivered(time)

    def _delivered(self, time: int) -> Iterator[Telemetry]:
        while self._under_way and self._under_way[0][0] <= time:
            yield heappop(self._under_way)[-1]

    def _step(self) -> None:
        for name, vehicle in self._vehicles.items():
            vehicle.step(STEP_NS / SECOND_NS, self._scenario.wind(name, self._elapsed))
        self._elapsed += STEP_NS
        self._measure()

    def _measure(self) -> None:
        for channel, transport in TRANSPORT.items():
            if self._elapsed % transport.period == 0:
                for name, sensors in self._sensors.items():
                    # Measure lost messages, too: the noise of later ones must not change.
                    message = sensors.measure(
                        channel,
                        self._start + self._elapsed,
                        has_altitude=self._scenario.has_altitude(name, self._elapsed),
                    )
                    if not self._scenario.is_lost(name, channel, self._elapsed):
                        self._sent += 1
                        heappush(self._under_way, (message.delivery_time, self._sent, message))
