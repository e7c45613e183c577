"""Triggers as they are written in a robot.yaml."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_configuration import (
    PLACEHOLDERS,
    RobotConfiguration,
    Trigger,
    TriggerEvent,
    TriggerKind,
    export,
    filled,
    read_robot,
    single_placeholder,
)
from dyknow_configuration.triggers import DEFAULT_TIMEOUT

SECOND = 1_000_000_000
TEXT = """\
triggers:
  report:
    publish:
      topic: /faults
      type: diagnostic_msgs/msg/DiagnosticStatus
      message: {level: '{severity}', name: '{{x}} {name}', values: [{key: on, value: 'off'}]}
    min_interval: 10 s
formulas:
  - name: slow
    formula: a.b < 1
    margin: true
    on:
      false: [report, {run: [beep, '{margin}'], retries: 2, timeout: 1500 ms}]
      true: {cancel_goal: /dock}
      violation: report
      clear: {call: {service: /x, type: std_srvs/srv/SetBool, request: {data: true}}}
"""


def robot(folder: Path, text: str) -> RobotConfiguration:
    path = folder / 'robot.yaml'
    path.write_text(text, encoding='utf-8')
    return read_robot(path)


def test_triggers_and_their_events(tmp_path: Path) -> None:
    (formula,) = robot(tmp_path, TEXT).formulas
    report = Trigger(
        'report',
        TriggerKind.PUBLISH,
        '/faults',
        'diagnostic_msgs/msg/DiagnosticStatus',
        {
            'level': '{severity}',
            'name': '{{x}} {name}',
            'values': [{'key': True, 'value': 'off'}],
        },
        10 * SECOND,
        placeholders=frozenset({'severity', 'name'}),
    )
    beep = Trigger(
        'run beep', TriggerKind.RUN, 'beep', '', ['{margin}'], 0, 2, 1_500_000_000,
        frozenset({'margin'}),
    )  # fmt: skip
    call = Trigger('call /x', TriggerKind.CALL, '/x', 'std_srvs/srv/SetBool', {'data': True})
    cancel = Trigger('cancel_goal /dock', TriggerKind.CANCEL_GOAL, '/dock')
    assert formula.on == (
        (TriggerEvent.FALSE, report),
        (TriggerEvent.FALSE, beep),
        (TriggerEvent.TRUE, cancel),
        (TriggerEvent.VIOLATION, report),
        (TriggerEvent.CLEAR, call),
    )
    assert cancel.timeout == DEFAULT_TIMEOUT
    assert hash(formula) == hash(pickle.loads(pickle.dumps(formula)))  # noqa: S301


@pytest.mark.parametrize('event', TriggerEvent)
@pytest.mark.parametrize('key', ['on', '"on"', "'on'"])
def test_words_that_yaml_takes_for_booleans(tmp_path: Path, key: str, event: TriggerEvent) -> None:
    text = 'formulas:\n  - {name: a, formula: a.b < 1, %s: {%s: {run: [beep]}}}\n'
    for written in (event, f"'{event}'"):
        (formula,) = robot(tmp_path, text % (key, written)).formulas
        assert [each for each, _ in formula.on] == [event]


def test_a_fault_is_shown_at_the_value(tmp_path: Path) -> None:
    (formula,) = robot(tmp_path, TEXT).formulas
    report = formula.on[0][1]
    places = {
        ('content', 'level'): '6:25',
        ('content', 'level', None): '6:17',
        ('content', 'values', 0, 'key'): '6:75',
        ('content', 'values', 0, 'missing'): '6:69',
        ('type',): '5:13',
        (): '3:5',
    }
    for path, place in places.items():
        assert str(report.error('wrong', path)).startswith(
            f"{tmp_path}/robot.yaml:{place}: trigger 'report': wrong\n"
        )


def test_the_exported_triggers_are_the_same(tmp_path: Path) -> None:
    configuration = robot(tmp_path, TEXT)
    exported = read_robot(export(tmp_path / 'robot.yaml', tmp_path / 'files'))
    assert exported.formulas == configuration.formulas


def test_the_triggers_of_files_of_formulas(tmp_path: Path) -> None:
    head, _, tail = TEXT.partition('formulas:\n')
    (tmp_path / 'more.yaml').write_text(tail, encoding='utf-8')
    assert robot(tmp_path, f'{head}formulas: more.yaml\n') == robot(tmp_path, TEXT)


@given(st.lists(st.one_of(st.sampled_from([*PLACEHOLDERS]), st.text().map(lambda each: [each]))))
def test_texts_are_filled(parts: list[str | list[str]]) -> None:
    """A list of one text stands for this text itself."""
    braces = str.maketrans({'{': '{{', '}': '}}'})
    text = ''.join(
        f'{{{each}}}' if isinstance(each, str) else each[0].translate(braces) for each in parts
    )
    values = {name: f'<{name}>' for name in PLACEHOLDERS}
    assert filled(text, values) == ''.join(
        values[each] if isinstance(each, str) else each[0] for each in parts
    )


def test_a_text_that_is_one_placeholder() -> None:
    assert single_placeholder(' {margin} ') == 'margin'
    assert [single_placeholder(each) for each in ('{margin} m', '{{margin}}', 'margin')] == [
        None
    ] * 3
