"""Examples in other languages in docs/clients.md: names and fields exist, and they compile."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from ament_index_python.packages import get_resources
from dyknow_interfaces import action, msg, srv

from dyknow_reasoning import check_types, parse_formula
from services import SERVICES

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / 'docs' / 'examples' / 'watch_cpp'
SOURCE = (EXAMPLE / 'src' / 'watch.cpp').read_text(encoding='utf-8')
MANUAL = (ROOT / 'docs' / 'clients.md').read_text(encoding='utf-8')

ROS_COMMANDS = [
    shlex.split(line) for line in MANUAL.splitlines() if line.startswith(('ros2 serv', 'ros2 act'))
]

CPP_MESSAGES = {
    'request': srv.EvaluateFormula.Request,
    'goal': action.MonitorFormula.Goal,
    'feedback': action.MonitorFormula.Feedback,
    'answer': srv.EvaluateFormula.Response,
}
"""The types of the variables of the C++ example."""


def fill(message: Any, fields: dict[str, Any]) -> None:
    """Set fields of a message as the ROS command line does; raise for unknown ones."""
    types = message.get_fields_and_field_types()
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        elif types[name].startswith('sequence<dyknow_interfaces/'):
            made = getattr(msg, types[name].split('/')[1].rstrip('>'))
            setattr(message, name, [_filled(made(), each) for each in value])
        else:
            setattr(message, name, value)


def _filled(message: Any, fields: dict[str, Any]) -> Any:
    fill(message, fields)
    return message


def formulas(value: Any) -> Iterator[str]:
    """Yield all formulas in the fields of a request."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key == 'formula':
                yield inner
            yield from formulas(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from formulas(inner)


@pytest.mark.parametrize('line', ROS_COMMANDS, ids=lambda line: line[-2])
def test_the_commands_of_ros(line: list[str]) -> None:
    *_, name, type_name, text = line
    _, kind, class_name = type_name.split('/')
    made = getattr({'srv': srv, 'action': action}[kind], class_name)
    node = name.split('/')[1]
    actions = {'stream_reasoning_coordinator': {'MonitorFormula', 'MonitorPlan'}}
    assert class_name in (actions if kind == 'action' else SERVICES)[node]
    snake = re.sub(r'\B([A-Z])', r'_\1', class_name).lower()
    assert name == f'/{node}/{snake}'
    fields = yaml.safe_load(text)
    fill((made.Goal if kind == 'action' else made.Request)(), fields)
    for formula in formulas(fields):
        check_types(parse_formula(formula), formula)


def test_the_manual_shows_each_way_to_ask_on_a_shell() -> None:
    types = {line[-2].rpartition('/')[2] for line in ROS_COMMANDS}
    assert types == {
        'EvaluateFormula', 'MonitorFormula', 'MonitorPlan', 'ReportPlanAction',
        'ConceptCreate', 'InstanceCreate', 'AddSemanticSpecification',
    }  # fmt: skip


def test_the_fields_in_the_cpp_example() -> None:
    uses = re.findall(r'\b(request|goal|feedback|answer)(?:\.|->)(\w+)(?:\.(\w+))?', SOURCE)
    assert {variable for variable, *_ in uses} == set(CPP_MESSAGES)
    for variable, field, inner in uses:
        value = getattr(CPP_MESSAGES[variable](), field)
        assert not inner or inner == 'c_str' or hasattr(value, inner), (variable, field, inner)


def test_the_result_of_the_action_has_all_that_the_response_of_the_service_has() -> None:
    response = srv.EvaluateFormula.Response.get_fields_and_field_types()
    result = action.MonitorFormula.Result.get_fields_and_field_types()
    # Only an action may ask a formula at every state.
    assert {**response, 'episodes': 'dyknow_interfaces/FormulaEpisodes'} == result


def test_the_headers_of_the_cpp_example() -> None:
    for kind, header in re.findall(r'"dyknow_interfaces/(\w+)/(\w+)\.hpp"', SOURCE):
        assert (ROOT / 'dyknow_interfaces' / kind).is_dir()
        name = ''.join(word.capitalize() for word in header.split('_'))
        assert (ROOT / 'dyknow_interfaces' / kind / f'{name}.{kind}').is_file()


def test_the_formulas_of_the_cpp_example() -> None:
    texts = re.findall(r'"(forall [^"]*)"', SOURCE)
    assert len(texts) == 2
    for text in texts:
        check_types(parse_formula(text), text)


@pytest.mark.skipif(
    not {'rclcpp', 'rclcpp_action'} <= set(get_resources('packages')),
    reason='rclcpp and rclcpp_action are not installed, as on every machine without ROS 2',
)
@pytest.mark.timeout(600)
def test_the_cpp_example_compiles(tmp_path: Path) -> None:
    warnings = '-DCMAKE_CXX_FLAGS=-Werror'
    configure = ['cmake', '-S', str(EXAMPLE), '-B', str(tmp_path), warnings]
    for line in (configure, ['cmake', '--build', str(tmp_path)]):
        done = subprocess.run(
            line, env=dict(os.environ), capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
