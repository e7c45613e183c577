"""Layouts for viewers: the running demonstration has all their topics and fields."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import yaml
from rclpy.qos import QoSCompatibility, qos_check_compatible, qos_profile_sensor_data

from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    dyknow_processes,
    formula_markers,
    formula_monitor,
    uav_simulation,
)
from dyknow_bringup.processes.robot import fleet_configuration
from dyknow_bringup.resources import formulas_path, scenario_path, share
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_stream_processing.ros import message_class
from system import Client, private_environment

LAYOUTS = share() / 'layouts'
FOXGLOVE, RVIZ, PLOTJUGGLER = 'foxglove.json', 'rviz2.rviz', 'plotjuggler.xml'

TYPES = {
    'rviz_default_plugins/MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'rviz_default_plugins/Odometry': 'nav_msgs/msg/Odometry',
    '3D': 'visualization_msgs/msg/MarkerArray',
    'DiagnosticSummary': 'diagnostic_msgs/msg/DiagnosticArray',
    'RosOut': 'rcl_interfaces/msg/Log',
}
"""The messages that a display or a panel shows."""


def text_of(layout: str) -> str:
    return (LAYOUTS / layout).read_text(encoding='utf-8')


def foxglove() -> Any:
    return json.loads(text_of(FOXGLOVE))


def leaves(layout: Any) -> Iterator[str]:
    """Yield the panels of a layout of Foxglove, which is a binary tree."""
    if isinstance(layout, str):
        yield layout
        return
    assert set(layout) == {'direction', 'first', 'second', 'splitPercentage'}
    assert layout['direction'] in {'row', 'column'}
    assert 0 < layout['splitPercentage'] < 100
    yield from leaves(layout['first'])
    yield from leaves(layout['second'])


def rviz_displays() -> list[Any]:
    displays = yaml.safe_load(text_of(RVIZ))['Visualization Manager']['Displays']
    return [each for each in displays if 'Topic' in each]


def plotted() -> set[tuple[str, str]]:
    """The topics and fields of all curves."""
    curves = [
        each.attrib['name'].rpartition('/')
        for each in ET.fromstring(text_of(PLOTJUGGLER)).iter('curve')  # noqa: S314
    ]
    paths = [
        each['value'].partition('.')
        for panel in foxglove()['configById'].values()
        for each in panel.get('paths', ())
    ]
    (command_line,) = re.findall(r'`rqt_plot ([^`]+)`', docs_of_layouts())
    fields = [each.rpartition('/') for each in command_line.split()]
    return {(topic, field) for topic, _, field in (*curves, *paths, *fields)}


def docs_of_layouts() -> str:
    page = Path(__file__).parent.parent / 'docs' / 'operators.md'
    return page.read_text(encoding='utf-8')


def shown() -> set[tuple[str, str]]:
    """The topics of all displays, and the types of message that these show."""
    found = {(each['Topic']['Value'], TYPES[each['Class']]) for each in rviz_displays()}
    for name, panel in foxglove()['configById'].items():
        kind, _, _ = name.partition('!')
        if 'topicToRender' in panel:
            found.add((panel['topicToRender'], TYPES[kind]))
        found |= {(topic, TYPES[kind]) for topic in panel.get('topics', ())}
    return found


def test_all_layouts_are_tested() -> None:
    assert {path.name for path in LAYOUTS.iterdir()} == {FOXGLOVE, RVIZ, PLOTJUGGLER}


def test_the_panels_of_foxglove_are_those_of_its_layout() -> None:
    document = foxglove()
    assert set(document) == {
        'configById', 'globalVariables', 'userNodes', 'playbackConfig', 'layout'
    }  # fmt: skip
    panels = list(leaves(document['layout']))
    assert sorted(panels) == sorted(document['configById'])
    assert {each.partition('!')[0] for each in panels} == {
        '3D', 'DiagnosticSummary', 'Plot', 'RosOut', 'StateTransitions'
    }  # fmt: skip


def test_plotjuggler_subscribes_to_what_it_plots() -> None:
    root = ET.fromstring(text_of(PLOTJUGGLER))  # noqa: S314
    (streamer,) = root.iter('previouslyLoaded_Streamer')
    (plugin,) = root.iter('plugin')
    (topics,) = root.iter('selected_topics')
    assert plugin.attrib['ID'] == streamer.attrib['name']
    curves = [each.attrib['name'].rpartition('/')[0] for each in root.iter('curve')]
    assert set(topics.attrib['value'].split(';')) == set(curves)


def test_every_topic_and_field_exists(tmp_path: Path) -> None:
    """The demonstration publishes all of them, with the types that the layouts show."""
    environment = private_environment()
    wanted = {topic for topic, _ in plotted() | shown()}
    types: dict[str, str] = {}
    with closing(Client(environment)) as client:

        def is_complete() -> bool:
            types.update(
                (name, found)
                for name, (found, *_) in client.node.get_topic_names_and_types()
                if client.node.count_publishers(name)
            )
            return wanted <= types.keys()

        with Launcher(tmp_path, environment=environment) as launcher:
            launcher.start_all(
                [
                    *composed(dyknow_processes(fleet_configuration(vehicle_names(3))), {}),
                    uav_simulation(scenario_path('power_surge'), 3),
                    formula_monitor(formulas_path()),
                    formula_markers(),
                ]
            )
            client.spin_until(
                is_complete, 'all topics', instead=lambda: f'no {wanted - types.keys()}'
            )
            publishers = {
                topic: client.node.get_publishers_info_by_topic(topic)[0].qos_profile
                for topic in wanted
            }
    assert {(topic, types[topic]) for topic, _ in shown()} == shown()
    for topic, field in plotted():
        kind = message_class(types[topic]).get_fields_and_field_types()[field]
        assert kind in {'uint8', 'boolean', 'double', 'float'}, (topic, field)
    for topic, profile in publishers.items():
        # Plots subscribe as to sensors.
        compatibility, reason = qos_check_compatible(profile, qos_profile_sensor_data)
        assert compatibility != QoSCompatibility.ERROR, (topic, reason)
