from pathlib import Path

import pytest

from dyknow_bringup.simulation.scenario import Scenario, load_scenario
from dyknow_configuration import RequestedFormula, read_formulas

SHARE = Path(__file__).parent.parent


@pytest.fixture
def share() -> Path:
    """Return the folder of the package, whose data folders are installed."""
    return SHARE


@pytest.fixture(scope='session')
def scenarios() -> dict[str, Scenario]:
    paths = sorted((SHARE / 'scenarios').glob('*.yaml'))
    return {path.stem: load_scenario(path) for path in paths}


@pytest.fixture(scope='session')
def formulas() -> dict[str, RequestedFormula]:
    return {formula.name: formula for formula in read_formulas(SHARE / 'formulas' / 'uav.yaml')}
