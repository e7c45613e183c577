import pytest

from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.vehicle import vehicle_names


def test_names() -> None:
    assert vehicle_names(3) == ('uav1', 'uav2', 'uav3')


def test_a_fleet_of_none() -> None:
    with pytest.raises(BringupError) as error:
        vehicle_names(0)
    assert str(error.value) == 'a fleet of 0 vehicles cannot fly; have one at least'
