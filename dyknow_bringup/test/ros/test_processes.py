"""The list of processes."""

from pathlib import Path

import pytest
import yaml

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.arguments import CONFIGURATION, configuration, robots
from dyknow_bringup.processes.processes import (
    Process,
    SystemConfiguration,
    carrier_simulation,
    dyknow_processes,
    formula_markers,
    formula_monitor,
    ros_arguments,
    uav_simulation,
    watching_processes,
)
from dyknow_bringup.processes.robot import with_robot
from dyknow_bringup.resources import executable_path, scenario_names, scenario_path


def test_the_seven_nodes_are_installed() -> None:
    processes = dyknow_processes(SystemConfiguration())
    assert len(processes) == 7
    for process in processes:
        assert executable_path(process.package, process.executable).is_file()


def test_the_nodes_of_the_demonstration_are_installed() -> None:
    for process in (
        uav_simulation(Path('a.yaml'), 3), carrier_simulation('carrier1', 2.0),
        formula_monitor(Path('b.yaml')), formula_markers(),
    ):  # fmt: skip
        assert executable_path(process.package, process.executable).is_file()


def test_an_executable_that_is_not_there() -> None:
    with pytest.raises(BringupError, match="no executable 'nothing'"):
        executable_path('dyknow_bringup', 'nothing')


def test_parameters_are_written_as_yaml() -> None:
    process = Process('p', 'e', {'files': ['/a b', "/c'd"], 'n': 3, 'x': 0.5})
    arguments = ros_arguments(process, '/fleet', 'debug', use_sim_time=True)
    assert arguments[:5] == ['--ros-args', '--log-level', 'debug', '-r', '__ns:=/fleet']
    assert arguments[5:7] == ['--enclave', '/fleet/e']
    written = dict(each.split(':=', 1) for each in arguments[8::2])
    assert {name: yaml.safe_load(text) for name, text in written.items()} == {
        'files': ['/a b', "/c'd"],
        'n': 3,
        'x': 0.5,
        'use_sim_time': True,
    }


def test_scenarios_are_found_by_name_and_by_path(tmp_path: Path) -> None:
    assert 'nominal' in scenario_names()
    assert scenario_path('nominal').name == 'nominal.yaml'
    own = tmp_path / 'own.yaml'
    own.touch()
    assert scenario_path(str(own)) == own
    with pytest.raises(BringupError, match=r"no scenario 'picnic'; use delivery, .*power_surge"):
        scenario_path('picnic')


def test_store_and_reasoner() -> None:
    processes = dyknow_processes(SystemConfiguration(store=Path('/kept'), reasoner='hermit'))
    parameters = {process.executable: process.parameters for process in processes}
    assert parameters['ontology_manager'] == {
        'store': '/kept/ontology.sqlite3',
        'reasoner': 'hermit',
    }
    assert parameters['stream_semantics_manager'] == {'store': '/kept/annotations.sqlite3'}


def test_bridges_go_to_the_ontology_manager(tmp_path: Path) -> None:
    bridges = tmp_path / 'robots.bridges'
    bridges.touch()
    processes = dyknow_processes(SystemConfiguration(bridges=(bridges,)))
    parameters = {process.executable: process.parameters for process in processes}
    assert parameters['ontology_manager'] == {'bridges': [str(bridges)]}


@pytest.mark.parametrize('kind', ['ontologies', 'annotations', 'streams', 'bridges'])
def test_a_file_that_does_not_exist_is_named(kind: str) -> None:
    with pytest.raises(BringupError, match=rf'{kind}: there is no file /absent/nope\.txt'):
        SystemConfiguration(**{kind: (Path('/absent/nope.txt'),)})


def test_a_launch_argument_that_names_no_file() -> None:
    with pytest.raises(BringupError, match=r'ontologies: there is no file .*/nope\.owl'):
        configuration(robot_arguments(ontology='nope.owl'))


def robot_arguments(**given: str) -> dict[str, str]:
    return {**{name: default for name, (default, _) in CONFIGURATION.items()}, **given}


def test_each_robot_has_a_system_in_its_namespace(tmp_path: Path) -> None:
    for robot in ('robot1', 'robot2'):
        (tmp_path / f'{robot}.streams').touch()
    values = robot_arguments(
        robots='robot1, /robot2', streams=f'{tmp_path}/<robot>.streams', store='/kept/<robot>'
    )
    processes = {process.name: process for process in robots(values)}
    assert len(processes) == 14
    manager = processes['robot2/stream_manager']
    assert manager.parameters == {'streams': [f'{tmp_path}/robot2.streams']}
    assert '__ns:=/fleet/robot2' in ros_arguments(manager, 'fleet', 'info', use_sim_time=False)
    assert (
        processes['robot1/ontology_manager'].parameters['store'] == '/kept/robot1/ontology.sqlite3'
    )


def test_a_file_of_all_robots_is_warned_of_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text('stream_managr:\n  ros__parameters: {silence_limit: 3.0}\n')
    processes = robots(robot_arguments(robots='robot1,robot2,robot3', params_file=str(path)))
    assert len(processes) == 21
    assert capsys.readouterr().err.count('warning: ') == 1


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'robots': ''}, 'each robot needs a namespace .given: none'),
        ({'robots': 'a,/'}, 'each robot needs a namespace .given: a, /'),
        ({'robots': 'a,b,a'}, "namespace '/a' is that of another robot"),
        ({'robots': 'a,a/b'}, "namespace '/a/b' is that of another robot, or within it"),
        (
            {'robots': 'a,b', 'store': '/kept'},
            "cannot share the store '/kept'; name .*/kept/<robot>",
        ),
    ],
)
def test_robots_that_would_share_what_is_their_own(values: dict[str, str], words: str) -> None:
    with pytest.raises(BringupError, match=words):
        robots(robot_arguments(**values))


def test_a_namespace_that_begins_like_another() -> None:
    assert len(robots(robot_arguments(robots='robot1,robot10'))) == 14


def test_the_formulas_of_a_robot_are_monitored_if_there_are_any(tmp_path: Path) -> None:
    robot = tmp_path / 'robot.yaml'
    robot.write_text('formulas: [{name: a, formula: \'always "/a".b < 1\'}]', encoding='utf-8')

    def monitors(**values: str) -> list[str]:
        return [each.name for each in watching_processes(configuration(robot_arguments(**values)))]

    assert monitors(config=str(robot)) == ['formula_monitor']
    assert monitors(config=str(robot), monitor='false') == []
    found = dyknow_processes(configuration(robot_arguments(config=str(robot))))
    (coordinator,) = [each for each in found if each.name == 'stream_reasoning_coordinator']
    assert coordinator.parameters['keep_ended'] == 86_400.0
    assert monitors() == []
    robot.write_text('{}', encoding='utf-8')
    assert monitors(config=str(robot)) == []


def test_the_recorder_is_started_where_a_formula_has_a_black_box(tmp_path: Path) -> None:
    robot = tmp_path / 'robot.yaml'
    text = 'formulas: [{name: a, formula: \'always "/a".b < 1\', record: %s}]'
    for recorded, names in (('true', ['black_box_recorder']), ('false', [])):
        robot.write_text(text % recorded, encoding='utf-8')
        processes = dyknow_processes(with_robot(SystemConfiguration(), robot))
        found = [each for each in processes if each.package == 'dyknow_reactions']
        assert [each.name for each in found] == names
        assert [each.parameters for each in found] == [{'robot': str(robot)}] * len(names)
    folder = SystemConfiguration(recorder={'folder': '/boxes'})
    (*_, recorder) = dyknow_processes(with_robot(folder, robot))
    assert recorder.parameters == {'robot': str(robot), 'folder': '/boxes'}
