"""Triggers of formulas with real nodes: each kind of action, events, and what fails."""

from __future__ import annotations

import errno
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dyknow_interfaces.action import MonitorFormula
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from std_srvs.srv import SetBool

from commands import command, output_of
from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_configuration import ConfigurationError, RequestedFormula, read_robot
from dyknow_coordinator import Answer, Progress, StandingVerdicts, ViolationEpisode
from dyknow_reactions.ros.triggers import Triggers, actions, targets
from system import Client, private_environment

SECOND = 1_000_000_000
EPISODE = ViolationEpisode(SECOND, SECOND, 2 * SECOND, 1, has_ended=False, explanation='too fast')
VIOLATED = StandingVerdicts(3, 1, 0, 0, True, 1, (EPISODE,))
CLEAR = StandingVerdicts(4, 1, 0, 0, False, 1, (replace(EPISODE, has_ended=True),))
ANSWERS = {
    'false': Answer(Verdict.FALSE, 3 * SECOND, explanation='too fast'),
    'true': Answer(Verdict.TRUE, 3 * SECOND, explanation='it was slow'),
    'violation': Answer(error=DyKnowError('late', ExitCode.CONSTRAINT_VIOLATION)),
}
PUBLISH = (
    'publish: {topic: /faults, type: diagnostic_msgs/msg/DiagnosticStatus, message: '
    "{level: '{severity}', name: '{name}', message: '{event}: {explanation}'}}"
)
CALL = 'call: {service: /alarm, type: std_srvs/srv/SetBool, request: {data: true}}'
SEND = (
    'send_goal: {action: /dock, type: dyknow_interfaces/action/MonitorFormula, '
    'goal: {name: "{name}"}}'
)
CANCEL = '{cancel_goal: /dock}'
COMPLAIN = "run: [sh, -c, 'echo no speaker >&2; exit 3']"


def formula(folder: Path, on: str, *, every_state: bool = True) -> RequestedFormula:
    """Return a formula with triggers, read from a file."""
    path = folder / 'robot.yaml'
    asked = f'every_state: {str(every_state).lower()}'
    text = f'{{name: slow, formula: a.b < 1, severity: error, {asked}, on: {on}}}'
    path.write_text(f'formulas:\n  - {text}\n', encoding='utf-8')
    return read_robot(path).formulas[0]


class Observed:
    """The node that runs triggers, the servers, and what they have received."""

    def __init__(self, client: Client) -> None:
        self.client, self.node = client, client.node
        self.received: list[str] = []
        self.succeeds, self.says = True, 'busy'
        self.cancel_response = CancelResponse.ACCEPT
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._diagnose, 10)

    def _diagnose(self, array: DiagnosticArray) -> None:
        self.diagnostics |= {each.name.partition(': ')[2]: each for each in array.status}

    def listen(self) -> None:
        def receive(status: DiagnosticStatus) -> None:
            self.received.append(f'{status.level[0]} {status.name} {status.message}')

        self.node.create_subscription(DiagnosticStatus, '/faults', receive, 10)

    def serve(self) -> None:
        def respond(request: Any, response: Any) -> Any:
            self.received.append(f'called {request.data}')
            response.success, response.message = self.succeeds, self.says
            return response

        self.node.create_service(SetBool, '/alarm', respond)

    def act(self) -> None:
        def accept(goal: Any) -> GoalResponse:
            self.received.append(f'goal {goal.name}')
            return GoalResponse.ACCEPT

        def cancel(_: Any) -> CancelResponse:
            self.received.append('cancelled')
            return self.cancel_response

        async def execute(goal: Any) -> Any:
            goal.abort()
            return MonitorFormula.Result()

        def keep(goal: Any) -> None:
            """Keep the goal: it is not executed, so it can be cancelled."""

        ActionServer(
            self.node, MonitorFormula, '/dock', execute, goal_callback=accept,
            cancel_callback=cancel, handle_accepted_callback=keep,
        )  # fmt: skip

    @contextmanager
    def violated(self, folder: Path, trigger: str) -> Iterator[Triggers]:
        """A trigger whose formula has just become false."""
        requested = formula(folder, f'{{false: {trigger}}}')
        with Triggers(self.node, [requested]) as triggers:
            triggers.on_progress(requested, Progress(4, SECOND, '', episodes=VIOLATED))
            yield triggers

    def wait_for(self, *received: str) -> None:
        self.client.spin_until(
            lambda: len(self.received) >= len(received),
            str(received),
            instead=lambda: self.received,
        )
        assert self.received == [*received]

    def wait_for_level(self, level: bytes, text: str) -> DiagnosticStatus:
        """Wait until the only trigger is reported with a level and a text."""

        def found() -> list[DiagnosticStatus]:
            known = self.diagnostics.values()
            return [each for each in known if each.level == level and text in each.message]

        self.client.spin_until(lambda: bool(found()), text, instead=lambda: self.diagnostics)
        return found()[0]


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no test wait for nodes that it does not start."""
    monkeypatch.setattr(targets, 'DISCOVERY_S', 0.0)


@pytest.fixture
def observed(client: Client) -> Observed:
    return Observed(client)


@pytest.mark.parametrize('event', ['false', 'true', 'violation', 'clear'])
@pytest.mark.parametrize(
    ('action', 'server', 'wanted'),
    [
        (PUBLISH, Observed.listen, '{level} slow {event}: {text}'),
        (CALL, Observed.serve, 'called True'),
        (SEND, Observed.act, 'goal slow'),
    ],
    ids=['publish', 'call', 'send_goal'],
)
def test_actions_follow_events(
    observed: Observed,
    tmp_path: Path,
    event: str,
    action: str,
    server: Callable[[Observed], None],
    wanted: str,
) -> None:
    """The formula is asked once; its violation passes when states come again."""
    server(observed)
    once = formula(tmp_path, f'{{{event}: {{{action}, retries: 5}}}}', every_state=False)
    text = {
        'false': 'too fast',
        'true': 'it was slow',
        'violation': 'CONSTRAINT_VIOLATION: late',
        'clear': 'it has passed: CONSTRAINT_VIOLATION: late',
    }[event]
    level = 0 if event in {'true', 'clear'} else 2
    with Triggers(observed.node, [once]) as triggers:
        triggers.on_answer(once, ANSWERS['violation' if event == 'clear' else event])
        triggers.on_progress(once, Progress(0, SECOND, ''))
        if event == 'clear':
            triggers.on_progress(once, Progress(3, SECOND, ''))
        observed.wait_for(wanted.format(level=level, event=event, text=text))
        observed.client.spin_until(lambda: triggers.is_idle, 'the end of the run')
        assert [use.runs for use in triggers.uses] == [1]
        observed.wait_for_level(DiagnosticStatus.OK, 'done in attempt')


def test_a_command_gets_its_arguments(observed: Observed, tmp_path: Path) -> None:
    result = tmp_path / 'result'
    program = 'echo "$@" > "$0"'
    words = json.dumps(['sh', '-c', program, str(result), '{name}', '; {explanation}', '{{}}'])
    with observed.violated(tmp_path, f'{{run: {words}}}') as triggers:
        observed.client.spin_until(lambda: triggers.is_idle, 'the end of the command')
    assert result.read_text() == 'slow ; too fast {}\n'


def test_episodes_begin_and_end(observed: Observed, tmp_path: Path) -> None:
    observed.listen()
    trigger = f'{{{PUBLISH}, retries: 5}}'
    requested = formula(tmp_path, f'{{false: {trigger}, clear: {trigger}}}')
    with Triggers(observed.node, [requested]) as triggers:
        triggers.on_progress(requested, Progress(4, SECOND, '', episodes=VIOLATED))
        # Both have one target: the end is not reported before the begin.
        triggers.on_progress(requested, Progress(5, SECOND, '', episodes=CLEAR))
        observed.wait_for(
            '2 slow false: too fast',
            '0 slow clear: it was violated from 1.000 s to 1.000 s: too fast',
        )


def test_goals_are_cancelled(observed: Observed, tmp_path: Path) -> None:
    observed.act()
    requested = formula(tmp_path, f'{{false: [{{{SEND}, retries: 5}}], clear: [{CANCEL}]}}')
    with Triggers(observed.node, [requested]) as triggers:
        triggers.on_progress(requested, Progress(4, SECOND, '', episodes=VIOLATED))
        observed.wait_for('goal slow')
        triggers.on_progress(requested, Progress(5, SECOND, '', episodes=CLEAR))
        observed.wait_for('goal slow', 'cancelled')


def test_a_server_that_refuses_to_cancel(observed: Observed, tmp_path: Path) -> None:
    """A server of rclpy answers as if it had no goals, whose status tells that they run."""
    observed.cancel_response = CancelResponse.REJECT
    observed.act()
    on = f'{{true: {{{SEND}, retries: 5}}, false: [{CANCEL}]}}'
    requested = formula(tmp_path, on, every_state=False)
    with Triggers(observed.node, [requested]) as triggers:
        for event in 'true', 'false':
            triggers.on_answer(requested, ANSWERS[event])
            observed.client.spin_until(lambda: triggers.is_idle, event)
        assert triggers.uses[1].text == 'action /dock refuses to cancel its goals'


FAILURES = {
    'no node is known to subscribe to /faults': PUBLISH,
    'service /alarm is not available within 300 ms': CALL,
    'action /dock is not available within 300 ms': SEND,
    'exit code 3: no speaker': COMPLAIN,
    'the command has not ended: it was killed within 300 ms': 'run: [sleep, "60"]',
}


@pytest.mark.parametrize(('text', 'action'), FAILURES.items())
def test_a_trigger_that_fails(observed: Observed, tmp_path: Path, text: str, action: str) -> None:
    limit = ', timeout: 300 ms' if '300 ms' in text else ''
    begin = time.monotonic()
    with observed.violated(tmp_path, f'{{{action}, retries: 1{limit}}}') as triggers:
        assert time.monotonic() - begin < 5, 'it has waited'
        observed.wait_for_level(DiagnosticStatus.ERROR, text)
        (use,) = triggers.uses
        assert (use.runs, use.failures) == (1, 1)
        assert [entry for _, entry in use.log] == [f'{text}; attempt 2 in 1 s', text]


def test_an_attempt_has_its_whole_time_after_one_that_failed_soon(
    observed: Observed, tmp_path: Path
) -> None:
    """The limit of the first attempt, at 1.5 s, is not that of the second one, which ends later."""
    marker = tmp_path / 'marker'
    program = 'test -e "$0" && exec sleep 1; : >"$0"; exit 3'
    words = json.dumps(['sh', '-c', program, str(marker)])
    options = 'retries: 1, timeout: 1500 ms'
    with observed.violated(tmp_path, f'{{run: {words}, {options}}}') as triggers:
        observed.client.spin_until(lambda: triggers.is_idle, 'the second attempt')
        assert triggers.uses[0].text == 'done in attempt 2'


def test_a_server_that_refuses(observed: Observed, tmp_path: Path) -> None:
    observed.succeeds = False
    observed.serve()
    with observed.violated(tmp_path, f'{{{CALL}}}'):
        text = 'the service answers success: false (busy)'
        observed.wait_for_level(DiagnosticStatus.ERROR, text)


def test_events_within_the_interval_are_ignored(observed: Observed, tmp_path: Path) -> None:
    """All of them are in the diagnostics, also those at one time."""
    requested = formula(tmp_path, '{violation: {run: ["true"], min_interval: 1 h}}')
    with Triggers(observed.node, [requested]) as triggers:
        for _ in range(5):
            triggers.on_answer(requested, ANSWERS['violation'])
            triggers.on_progress(requested, Progress(1))
        status = observed.wait_for_level(DiagnosticStatus.OK, 'done in attempt 1')
        assert {each.key: each.value for each in status.values}['ignored events'] == '4'
        entries = [each.value for each in status.values if each.key.endswith(' ago')]
        assert len(entries) == 5, status


def test_a_command_that_prints_much(
    observed: Observed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its error output does not fill the disk, and its end is told."""
    files: list[Any] = []

    def noted(*arguments: Any, **options: Any) -> Any:
        files.append(tempfile.TemporaryFile(*arguments, **options))  # noqa: SIM115 - of a command
        return files[-1]

    monkeypatch.setattr(actions, 'tempfile', SimpleNamespace(TemporaryFile=noted))
    program = 'head -c 10000000 /dev/zero; head -c 10000000 /dev/zero >&2; : >"$1"; read x <"$0"; '
    program += 'echo the end >&2; exit 4'
    go_on, has_printed = tmp_path / 'go_on', tmp_path / 'has_printed'
    os.mkfifo(go_on)
    words = json.dumps(['sh', '-c', program, str(go_on), str(has_printed)])
    with observed.violated(tmp_path, f'{{run: {words}, timeout: 60 s}}') as triggers:
        (file,) = files

        def is_emptied() -> bool:
            return has_printed.exists() and os.fstat(file.fileno()).st_size == 0

        observed.client.spin_until(is_emptied, 'the file is emptied')
        go_on.write_text('go on\n', encoding='utf-8')
        observed.client.spin_until(lambda: triggers.is_idle, 'the end of the command')
        (use,) = triggers.uses
        assert use.text.startswith('exit code 4: ')
        assert use.text.endswith('the end')
        assert len(use.text) < 2 * actions.SHOWN


@pytest.mark.filterwarnings('ignore:subprocess:ResourceWarning')
def test_a_command_that_may_not_be_killed(
    observed: Observed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `sudo` does, it runs as another user; that is no exception, and nothing hangs."""

    def refuse(*_: int) -> None:
        raise PermissionError(errno.EPERM, 'Operation not permitted')

    requested = formula(tmp_path, '{false: {run: [sleep, "5"], timeout: 100 ms}}')
    with Triggers(observed.node, [requested]) as triggers:
        with monkeypatch.context() as patch:
            patch.setattr(actions.os, 'killpg', refuse)
            triggers.on_progress(requested, Progress(4, SECOND, '', episodes=VIOLATED))
            observed.client.spin_until(lambda: triggers.is_idle, 'the timeout')
        assert triggers.uses[0].text == (
            'the command has not ended, and runs as another user who alone may kill it '
            'within 100 ms'
        )


def test_a_long_reason_is_shortened(observed: Observed, tmp_path: Path) -> None:
    observed.succeeds, observed.says = False, 'x' * 1_000_000
    observed.serve()
    with observed.violated(tmp_path, f'{{{CALL}}}'):
        status = observed.wait_for_level(DiagnosticStatus.ERROR, 'success: false (xxx')
        assert len(status.message) < 300


def test_commands_end_with_the_node(observed: Observed, tmp_path: Path) -> None:
    mark = tmp_path / 'mark'
    words = ['sh', '-c', f'sleep 2; touch {mark}']
    with observed.violated(tmp_path, f'{{run: {json.dumps(words)}}}'):
        pass
    time.sleep(3)
    assert not mark.exists()


BAD = {
    '{publish: {topic: /a, type: std_msgs/msg/String, message: {dat: x}}}': (
        "std_msgs/msg/String has no field 'dat'; did you mean 'data'?",
        'dat: x',
    ),
    '{run: [no_such_command]}': ("there is no command 'no_such_command'", 'no_such'),
    '{cancel_goal: "/{a}/b"}': ("the action '/{a}/b' cannot be the name of a topic", '/{a}/b'),
}
"""One of each kind of check; all faults of messages are in the tests of `lint`."""


@pytest.mark.parametrize(('trigger', 'message', 'place'), [(k, *v) for k, v in BAD.items()])
def test_what_does_not_exist_is_refused_at_the_start(
    observed: Observed, tmp_path: Path, trigger: str, message: str, place: str
) -> None:
    with pytest.raises(ConfigurationError) as error:
        Triggers(observed.node, [formula(tmp_path, f'{{false: {trigger}}}')])
    assert message in str(error.value)
    assert str(error.value).startswith(f'{tmp_path}/robot.yaml:2:')
    shown, caret = str(error.value).splitlines()[-2:]
    assert shown[caret.index('^') :].startswith(place), error.value


@pytest.mark.parametrize(('verb', 'code'), [('lint', 1), ('monitor', 2)])
def test_verbs_show_what_is_not_installed(tmp_path: Path, verb: str, code: int) -> None:
    formula(tmp_path, '{false: {publish: {topic: /a, type: nav9_msgs/msg/A}}}')
    line = command('dyknow', verb, str(tmp_path / 'robot.yaml'))
    done = output_of(line, private_environment())
    assert done.returncode == code
    said = done.stdout if verb == 'lint' else done.stderr
    assert 'install the package nav9_msgs' in said
    assert 'robot.yaml:2:' in said


def test_a_message_with_all_kinds_of_fields(observed: Observed, tmp_path: Path) -> None:
    message = (
        '{header: {stamp: "{time}", frame_id: "{name}"}, status: [{level: 2, name: a, values: '
        '[{key: severity, value: "{severity}"}]}, {level: "{verdict}", message: "{{{event}}}"}]}'
    )
    kind = 'diagnostic_msgs/msg/DiagnosticArray'
    received = observed.client.collect(DiagnosticArray, '/all')
    trigger = f'{{publish: {{topic: /all, type: {kind}, message: {message}}}, retries: 5}}'
    with observed.violated(tmp_path, trigger):
        observed.client.spin_until(lambda: bool(received), 'the message')
    (found,) = received
    assert (found.header.stamp.sec, found.header.frame_id) == (2, 'slow')
    first, second = found.status
    assert (first.level, first.values[0].value) == (b'\x02', 'error')
    assert (second.level, second.message) == (b'\x02', '{false}')
