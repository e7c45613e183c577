from pathlib import Path

import pytest

from dyknow_bringup.simulation.scenario import Scenario, load_scenario
from dyknow_common import NANOSECONDS, ExitCode
from dyknow_configuration import ConfigurationError, RequestedFormula

BAD = sorted((Path(__file__).parent / 'bad_scenarios').glob('*.yaml'))


def test_the_scenarios(scenarios: dict[str, Scenario]) -> None:
    assert list(scenarios) == [
        'delivery',
        'geofence',
        'gps_loss',
        'near_miss',
        'nominal',
        'power_surge',
        'telemetry_loss',
        'windy_delivery',
    ]


def test_a_scenario_as_written(scenarios: dict[str, Scenario]) -> None:
    surge = scenarios['power_surge']
    assert surge.name == 'power_surge'
    assert surge.description.startswith('uav2 meets two gusts of head wind. The first')
    assert surge.duration == 20 * NANOSECONDS['s']
    assert [gust.wind for gust in surge.gusts] == [(-7, 0, 0), (-7, 0, 0)]
    assert surge.expected['power'].outcome == 'false'
    assert surge.expected['power'].decided_between == (
        13 * NANOSECONDS['s'],
        15 * NANOSECONDS['s'],
    )
    assert surge.expected['ceiling'].decided_between is None
    assert surge.vehicles == {'uav2'}


def test_every_scenario_says_how_every_formula_ends(
    scenarios: dict[str, Scenario], formulas: dict[str, RequestedFormula]
) -> None:
    for scenario in scenarios.values():
        assert list(scenario.expected) == list(formulas)
        assert scenario.description.endswith('.')
        for expectation in scenario.expected.values():
            if expectation.decided_between is not None:
                assert expectation.decided_between[1] < scenario.duration


@pytest.mark.parametrize('path', BAD, ids=[path.stem for path in BAD])
def test_a_bad_scenario_is_explained(path: Path) -> None:
    with pytest.raises(ConfigurationError) as error:
        load_scenario(path)
    message = str(error.value).replace(f'{path.parent}/', '')
    assert message == path.with_suffix('.expected').read_text(encoding='utf-8').strip()


def test_there_are_bad_scenarios() -> None:
    assert len(BAD) > 10


def test_a_scenario_that_is_not_there(share: Path) -> None:
    with pytest.raises(ConfigurationError, match=r'cannot read .*nominall\.yaml') as error:
        load_scenario(share / 'scenarios' / 'nominall.yaml')
    assert error.value.code == ExitCode.NOT_FOUND


def test_a_folder_is_no_scenario(share: Path) -> None:
    with pytest.raises(ConfigurationError, match='cannot read'):
        load_scenario(share)
