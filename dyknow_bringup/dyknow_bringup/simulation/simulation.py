"""The simulation of a fleet: the same telemetry for the same seed, live or recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from typing import Final

import numpy as np

from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.telemetry import TRANSPORT, Channel, Sensors, Telemetry
from dyknow_bringup.simulation.vehicle import Vector, Vehicle
from dyknow_common import NANOSECONDS, SECOND_NS

STEP: Final = 25 * NANOSECONDS['ms']
"""The fixed step of the physics in nanoseconds; every period of telemetry is a multiple of it."""

_STEP_SECONDS = STEP / SECOND_NS


class Simulation:
    """A fleet that flies a scenario.

    The telemetry depends on the scenario, the vehicles and the start only, not on when it is
    asked for; a vehicle's noise does not depend on how many others there are.

    Args:
        scenario: what happens.
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
        """The messages delivered since the last call, up to and including a time, in order.

        Args:
            time: in nanoseconds.
        """
        while self._start + self._elapsed + STEP <= time:
            yield from self._delivered(self._start + self._elapsed)
            self._step()
        yield from self._delivered(time)

    def _delivered(self, time: int) -> Iterator[Telemetry]:
        while self._under_way and self._under_way[0][0] <= time:
            yield heappop(self._under_way)[-1]

    def _step(self) -> None:
        for name, vehicle in self._vehicles.items():
            vehicle.step(_STEP_SECONDS, self._wind(name))
        self._elapsed += STEP
        self._measure()

    def _wind(self, vehicle: str) -> Vector:
        winds = [gust.wind_at(self._elapsed) for gust in self._scenario.gusts_on(vehicle)]
        return np.sum(winds, axis=0) if winds else np.zeros(3)

    def _measure(self) -> None:
        for channel, transport in TRANSPORT.items():
            if self._elapsed % transport.period == 0:
                for name, sensors in self._sensors.items():
                    message = sensors.measure(channel, self._start + self._elapsed)
                    self._send(name, channel, message)

    def _send(self, vehicle: str, channel: Channel, message: Telemetry) -> None:
        if not self._scenario.is_lost(vehicle, channel, self._elapsed):
            self._sent += 1
            heappush(self._under_way, (message.delivery_time, self._sent, message))
