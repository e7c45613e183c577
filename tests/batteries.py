"""The telemetry of a fleet, which a test controls."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import UserDict
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableSet, Sequence
from typing import TYPE_CHECKING, Any

import battery_publishers
from commands import started

if TYPE_CHECKING:
    from system import Client


class Batteries:
    """Publishes the batteries of a fleet, five times a second, with the power that a test sets.

    A process of its own publishes them: a test that is busy or has no processor for seconds would
    break the constraints of all streams. Changes are effective when a statement returns.

    Args:
        client: waits.
        environment: variables of the process.
        vehicles: their names.
    """

    PERIOD = battery_publishers.PERIOD
    SETTLING_TIME = 1_600_000_000

    def __init__(
        self, client: Client, environment: Mapping[str, str], vehicles: Sequence[str]
    ) -> None:
        self.power = _Power(vehicles, lambda changed: self._request(power=changed))
        self.silent: MutableSet[str] = _Silent(lambda silent: self._request(silent=silent))
        self._client = client
        line = [sys.executable, battery_publishers.__file__, *vehicles]
        self._process = started(line, environment, stdin=subprocess.PIPE, stderr=None)
        self._settled = self.stamp + self.PERIOD

    def close(self) -> None:
        """End the process."""
        self._process.communicate()
        assert self._process.returncode == 0

    @property
    def stamp(self) -> int:
        """The stamp of the latest samples, nanoseconds."""
        return self._request()[0]

    def change(self, **power: float) -> int:
        """Set the power of vehicles from one sample on, and return the stamp of the one before."""
        self.power.data.update(power)
        return self._request(power=power)[0]

    def publish(self, vehicle: str, stamp: int, power: float | None = None) -> None:
        """Publish the battery of a vehicle as it was at a time, nanoseconds."""
        self._request(once=[vehicle, stamp, self.power[vehicle] if power is None else power])

    def publish_after_latest(self, vehicle: str, delay: int, power: float | None = None) -> None:
        """Publish the battery of a vehicle, stamped by a delay after the latest, nanoseconds."""
        used = self.power[vehicle] if power is None else power
        self._request(once=[vehicle, delay, used], after_latest=True)

    def overtake(self, vehicle: str, power: float) -> int:
        """Publish the next sample but one, of some power, before the next; return its stamp."""
        return self._request(overtaking={vehicle: power})[0] + 2 * self.PERIOD

    def reset(self) -> None:
        """Publish 100 W everywhere, regularly, and wait until what was before is past."""
        calm = dict.fromkeys(self.power, battery_publishers.CALM)
        is_calm = self.power == calm and not self.silent
        self.silent.clear()
        stamp = self.change(**calm)
        if not is_calm:
            self._settled = max(self._settled, stamp + self.PERIOD)
        self._client.spin_until(self._is_settled, 'regular batteries')

    def _is_settled(self) -> bool:
        stamp, late = self._request()
        self._settled = max(self._settled, late + self.SETTLING_TIME)
        return stamp >= self._settled

    def _request(self, **request: Any) -> tuple[int, int]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(request), file=self._process.stdin, flush=True)
        stamp, late = self._process.stdout.readline().split()
        return int(stamp), int(late)


class _Power(UserDict[str, float]):
    """The power of vehicles, whose changes are told."""

    def __init__(self, vehicles: Iterable[str], tell: Callable[[dict[str, float]], object]) -> None:
        super().__init__()
        self.data.update(dict.fromkeys(vehicles, battery_publishers.CALM))
        self._tell = tell

    def __setitem__(self, vehicle: str, power: float) -> None:
        self.data[vehicle] = power
        self._tell({vehicle: power})


class _Silent(MutableSet[str]):
    """The vehicles that publish nothing, whose changes are told."""

    def __init__(self, tell: Callable[[list[str]], object]) -> None:
        self._vehicles: set[str] = set()
        self._tell = tell

    def __contains__(self, vehicle: object) -> bool:
        return vehicle in self._vehicles

    def __iter__(self) -> Iterator[str]:
        return iter(self._vehicles)

    def __len__(self) -> int:
        return len(self._vehicles)

    def add(self, vehicle: str) -> None:
        self._vehicles.add(vehicle)
        self._tell(sorted(self._vehicles))

    def discard(self, vehicle: str) -> None:
        self._vehicles.discard(vehicle)
        self._tell(sorted(self._vehicles))
