"""The examples of the folder `examples`: every fault changes just the outcomes that it should."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader

from commands import command, dyknow_up, output_of, running, started
from dashboards import dashboard
from dyknow_configuration import read_robot
from dyknow_recordings import (
    MonitoringFiles,
    Outcome,
    RecordingReport,
    evaluate_recording,
    open_recording,
)
from dyknow_stream_processing.ros import message_class
from fake_robots import EXAMPLES, FOLDER, SIMULATE, Example
from page_client import receive
from system import private_environment

RECORDINGS = [(example, name) for example in EXAMPLES for name in example.expected['recordings']]
FAULTS = [(example, fault) for example in EXAMPLES for fault in example.faults]


def test_without_an_environment() -> None:
    done = subprocess.run(
        [sys.executable, '-S', '-E', str(SIMULATE), 'rover'],
        env={'PATH': os.defpath},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == 'simulate.py: there is no ROS here; run first: source env.sh\n'


def name_of(value: object) -> str:
    return value.name if isinstance(value, Example) else str(value)


def check(example: Example, bag: Path) -> RecordingReport:
    robot = read_robot(example.configuration)
    files = MonitoringFiles(robot.ontologies, robot.annotations, robot.streams)
    with open_recording(bag) as recording:
        return evaluate_recording(recording, robot.formulas, files)


def messages(path: Path) -> list[tuple[str, int, str]]:
    """The messages of a bag. Their bytes differ: Fast CDR leaves those between fields undefined."""
    with AnyReader([path]) as reader:
        return [
            (each.topic, time, str(deserialize_message(data, message_class(each.msgtype))))
            for each, time, data in reader.messages()
        ]


def test_all_examples_are_tested() -> None:
    assert {each.name for each in EXAMPLES} == {
        path.parent.name for path in FOLDER.glob('*/robot.yaml')
    }


@pytest.mark.parametrize('example', EXAMPLES, ids=name_of)
def test_the_expectations_name_what_there_is(example: Example) -> None:
    expected = example.expected
    formulas = {each.name for each in read_robot(example.configuration).formulas}
    assert {*expected['faults']} == {*example.faults}
    assert formulas >= {*expected['always']}.union(*expected['faults'].values())
    folders = {path.name for path in (example.folder / 'recordings').iterdir()}
    assert {*expected['recordings']} == folders


@pytest.mark.parametrize(('example', 'name'), RECORDINGS, ids=name_of)
def test_recordings_are_checked(example: Example, name: str) -> None:
    """The command, as the pages of the examples show it."""
    bag = example.folder / 'recordings' / name
    line = command('dyknow', 'check', str(bag), '--config', str(example.configuration), '--json')
    done = output_of(line, {})
    faults = example.expected['recordings'][name]
    assert done.returncode == (1 if faults else 0), done.stderr
    report = json.loads(done.stdout)
    assert report['notes'] == []
    outcomes = {each['name']: each['outcome'] for each in report['formulas']}
    decided = {name: outcome for name, outcome in outcomes.items() if outcome != 'undecided'}
    assert decided == example.outcomes(faults)


@pytest.mark.parametrize(('example', 'name'), RECORDINGS, ids=name_of)
def test_recordings_are_those_of_the_fake_robot(
    example: Example, name: str, tmp_path: Path
) -> None:
    example.record(example.expected['recordings'][name], tmp_path / name)
    assert messages(example.folder / 'recordings' / name) == messages(tmp_path / name)


@pytest.mark.parametrize(('example', 'fault'), FAULTS, ids=name_of)
def test_each_fault_changes_its_outcomes(example: Example, fault: str, tmp_path: Path) -> None:
    example.record([fault], tmp_path / fault)
    report = check(example, tmp_path / fault)
    decided = {
        each.name: str(each.outcome)
        for each in report.formulas
        if each.outcome is not Outcome.UNDECIDED
    }
    assert decided == example.outcomes([fault])
    wants = {
        each.name: name
        for each in report.formulas
        for episode in each.episodes
        for name, _ in episode.wants
    }
    assert wants == example.expected.get('wants', {}).get(fault, {})


@pytest.mark.parametrize('example', EXAMPLES, ids=name_of)
def test_the_page_names_what_each_fault_breaks(example: Example) -> None:
    page = (example.folder / 'README.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| (\w[\w ]*) \| .* \| (.*?) ?\|$', page, re.MULTILINE)
    shown = [(name, re.findall(r'`(\w+)`', faults)) for name, faults in rows]
    broken = [
        (
            formula.name,
            [
                fault
                for fault, outcomes in example.expected['faults'].items()
                if outcomes.get(formula.name) == 'false'
            ],
        )
        for formula in read_robot(example.configuration).formulas
    ]
    assert shown == broken
    for each in re.findall(r'--fault (\w+)', page):
        assert each in example.faults
    for each in re.findall(r'examples/[\w/.]+', page):
        assert (FOLDER.parent / each).exists(), each


@contextmanager
def changes(line: list[str], environment: dict[str, str]) -> Iterator[Iterator[dict[str, Any]]]:
    """Run `dyknow monitor --json`, and yield its lines as they come."""
    with started(line, environment, stderr=subprocess.DEVNULL) as process:
        yield (json.loads(each) for each in process.stdout if each.startswith('{'))
        process.send_signal(signal.SIGTERM)


def check_map(address: str) -> None:
    """The page shows where the robot was when it had passed the barrier."""
    marks = re.compile(r'<circle cx="([^"]*)".*?<title>([^<]*)</title>')

    def is_beyond(message: Any) -> bool:
        """It is for 20 ms; before its position has come, a mark is where it was before."""
        found = marks.findall(message['image']) if message['type'] == 'map' else []
        return [float(x) > 11.02 for x, _ in found] == [True]

    found = receive(address, 'formulas', 'barrier', is_beyond)['image']
    assert '<title>barrier: false</title>' in found
    ((_, reason),) = marks.findall(found)
    assert reason.startswith('barrier: robot3 at ')


@pytest.mark.parametrize(
    ('name', 'fault'),
    [
        ('arm', 'joint_limit'),
        ('handover', 'hasty_release'),
        ('rover', 'lost_odometry'),
        ('warehouse', 'breach'),
    ],
)
def test_the_running_system_finds_a_fault(name: str, fault: str) -> None:
    example = Example(name)
    expected = example.expected['faults'][fault]
    environment = private_environment()
    robot = [sys.executable, str(SIMULATE), name, '--fault', fault]
    configuration = str(example.configuration)
    with dyknow_up(environment, configuration, '--no-monitor'):
        page = dashboard(environment, 0, configuration) if name == 'warehouse' else nullcontext('')
        with running(robot, environment), page as address:
            line = command('dyknow', 'monitor', configuration, '--json')
            found = {}
            with changes(line, environment) as reports:
                for each in reports:
                    outcome = each['outcome']
                    found[each['name']] = 'error' if outcome == 'CONSTRAINT_VIOLATION' else outcome
                    if found.items() >= expected.items():
                        break
                if address:
                    check_map(address)
    decided = {name: each for name, each in found.items() if each not in {'undecided', 'waiting'}}
    assert expected.items() <= decided.items() <= example.outcomes([fault]).items(), found
