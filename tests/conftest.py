"""Fixtures of the system tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from collections.abc import Iterator

from evaluations import Evaluations, Spares
from system import Batteries, Client, System, private_environment


@pytest.fixture(scope='module')
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """DyKnow for two vehicles, shared by the tests of a module."""
    with System(tmp_path_factory.mktemp('system')) as running:
        yield running


@pytest.fixture(scope='module')
def batteries(system: System) -> Batteries:
    """The telemetry of the vehicles."""
    return Batteries(system.client, system.vehicles)


@pytest.fixture(scope='module')
def evaluations(system: System) -> Evaluations:
    """What the coordinator tells of all evaluations."""
    return Evaluations(system)


@pytest.fixture
def spares(system: System) -> Iterator[Spares]:
    """Streams that a test makes beside those of the fleet, and their annotations."""
    made = Spares(system)
    yield made
    made.clear()


@pytest.fixture
def calm(batteries: Batteries, evaluations: Evaluations) -> Iterator[None]:
    """The test begins with 100 W everywhere, and leaves nothing behind."""
    batteries.silent.clear()
    batteries.power.update(dict.fromkeys(batteries.power, 100.0))
    yield
    evaluations.wait_for_nothing()


@pytest.fixture
def client() -> Iterator[Client]:
    """A node in a private domain of its own."""
    alone = Client(private_environment())
    yield alone
    alone.close()
