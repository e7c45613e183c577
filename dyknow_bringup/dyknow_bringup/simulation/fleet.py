"""The names of the vehicles of a fleet."""

from __future__ import annotations

from dyknow_bringup.errors import BringupError


def vehicle_names(count: int) -> tuple[str, ...]:
    """Return the names of the vehicles of a fleet: uav1, uav2 and so on.

    Raises:
        BringupError: for less than one vehicle.
    """
    if count < 1:
        raise BringupError(f'a fleet of {count} vehicles cannot fly; have one at least')
    return tuple(f'uav{number}' for number in range(1, count + 1))
