"""Concepts that a client creates, without any file, from their creation to a verdict."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray, ExitStatus
from std_msgs.msg import Float64

from commands import command, dyknow_up, output_beside, output_of
from dyknow_common.ros import LATCHED
from services import assert_refused
from system import Client, private_environment

EXAMPLE = Path(__file__).parent.parent / 'docs' / 'examples' / 'name_a_feature.py'
EVALUATIONS = 'stream_reasoning_coordinator/evaluations'
FORMULA = 'forall b in Boat: always[0 s, 1 s] Draught[b] < 2.5'


@contextmanager
def dyknow_with_a_boat(*options: str) -> Iterator[tuple[Client, dict[str, str]]]:
    """Run DyKnow without an object, and publish the draught of a boat."""
    environment = private_environment()
    with dyknow_up(environment, *options):
        client = Client(environment)
        publisher = client.node.create_publisher(Float64, '/boat1/draught', 10)
        client.node.create_timer(0.1, lambda: publisher.publish(Float64(data=120.0)))
        with closing(client):
            client.wait_for_coordinator()
            yield client, environment


def output(client: Client, line: list[str], environment: dict[str, str]) -> str:
    """Return the output of a successful command, while the topics are published."""
    done = output_beside(client, line, environment)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_the_example_without_a_publisher() -> None:
    environment = private_environment()
    program = EXAMPLE.read_text(encoding='utf-8').replace('timeout=30.0, wait', 'timeout=1.0, wait')
    assert 'timeout=1.0' in program
    with dyknow_up(environment):
        done = output_of(['python3', '-c', program], environment)
    assert done.returncode == 1
    assert 'Traceback' not in done.stderr
    message = done.stderr.splitlines()[-1]
    assert message.startswith('name_a_feature: ')
    assert '/boat1/draught' in message


@pytest.mark.timeout(300)
def test_the_example_and_a_restart_of_the_system(tmp_path: Path) -> None:
    with dyknow_with_a_boat('--store', str(tmp_path)) as (client, environment):
        printed = output(client, ['python3', str(EXAMPLE)], environment)
        assert "TRUE for b = boat1: 'Draught[boat1] < 2.5' held at every state" in printed
        needs_none = output(client, command('dyknow', 'evaluate', '2 < 3', '--json'), environment)
        assert json.loads(needs_none)['decided_at_ns'] is None
        text = output(client, command('dyknow', 'evaluate', '2 < 3'), environment)
        assert text == 'true: it is true, whatever the states are\n'
    with dyknow_with_a_boat('--store', str(tmp_path)) as (client, environment):
        line = command('dyknow', 'evaluate', FORMULA, '--timeout', '30 s', '--json')
        answer = json.loads(output(client, line, environment))
        assert answer['verdict'] == 'true'
        assert answer['decided_at_ns'] > 0
        semantics = command('semantics', '--json')
        concepts = json.loads(output(client, semantics, environment))['concepts']
        [draught] = [each for each in concepts if each['name'] == 'Draught']
        assert draught['text'] == 'Draught[Boat]: float in m'
        assert draught['streams']
        destroy = 'ontology_manager/concept_destroy'
        refused = client.call(srv.ConceptDestroy, destroy, concept_name='Boat').exit_status
        assert_refused(refused, ExitStatus.INVALID_ARGUMENT, 'instances boat1', 'features Draught')
        done = client.call(srv.ConceptDestroy, destroy, concept_name='Draught').exit_status
        assert done.code == ExitStatus.SUCCESS, done.message
        [fault] = json.loads(output(client, semantics, environment))['faults'].values()
        assert "unknown concept 'Draught'" in fault


@pytest.mark.timeout(300)
def test_a_formula_of_a_robot_file_follows_the_objects_of_its_sort(tmp_path: Path) -> None:
    robot = tmp_path / 'port.yaml'
    robot.write_text(
        'objects: {Boat: []}\n'
        'features: {Draught: {of: {b: Boat}, from: {topic: "/{b}/draught", field: data}}}\n'
        'formulas: [{name: deep, formula: "forall b in Boat: always Draught[b] < 100"}]\n'
    )
    with dyknow_with_a_boat(str(robot)) as (client, environment):
        heard = client.collect(EvaluationStatusArray, EVALUATIONS, LATCHED)

        def status() -> Any:
            return heard[-1].evaluations[-1] if heard and heard[-1].evaluations else None

        waits = 'true for the objects of Boat, whatever the states are; it begins again'
        client.spin_until(lambda: status() and status().waits_for, 'it waits for a boat')
        assert waits in status().waits_for
        assert status().phase == EvaluationStatus.WAITING
        line = command('dyknow', 'monitor', str(robot), '--duration', '0.1 s')
        shown = output_beside(client, line, environment)
        assert (shown.returncode, waits in shown.stdout) == (2, True), shown.stdout
        create = 'ontology_manager/instance_create'
        client.call(srv.InstanceCreate, create, instance_name='boat1', concept_names=['Boat'])
        client.call(
            srv.AddSemanticSpecification,
            'stream_semantics_manager/add_semantic_specification',
            ssl_statement='stream "/boat1/draught" contains Draught[boat1] = data;',
        )
        client.spin_until(lambda: status().phase == EvaluationStatus.ENDED, 'it is decided')
        assert 'Draught[boat1] = 120' in status().explanation
