"""The command `dyknow policy`, and the warning of `dyknow up` about security without effect."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from dyknow_bringup.errors import BringupError
from dyknow_bringup.ros.policy import add_policy_options
from dyknow_bringup.ros.up import is_unenforced
from dyknow_bringup.security.systems import SecuredSystem


def parsed(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_policy_options(parser)
    return parser.parse_args(arguments)


def test_the_policy_of_a_system_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    streams = tmp_path / 'own.streams'
    streams.write_text('stream a = select x from "odom"; sink a', encoding='utf-8')
    chosen = parsed(
        '--namespace', 'robot1', '--streams', str(streams), '--topic', '/map',
        '--engine', 'e1', 'e2', '--client', 'pilot', '--snapshot-service', '/bag/snapshot',
    )  # fmt: skip
    assert chosen.command(chosen) == 0
    printed = capsys.readouterr().out
    system = SecuredSystem('robot1', frozenset({'odom', '/map'}), ('e1', 'e2'), ('pilot',))
    for enclave in system.enclaves():
        assert printed.count(f'<enclave path="{enclave.path}">') == 1
    assert printed.count('<service>/bag/snapshot</service>') == 1
    for topic in ('/robot1/odom', '/map'):
        # The recorder of black boxes reads them, too.
        assert printed.count(f'<topic>{topic}</topic>') == len(system.engines) + 1


def test_a_wrong_file_is_named(tmp_path: Path) -> None:
    chosen = parsed('--streams', str(tmp_path / 'none'))
    with pytest.raises(BringupError, match=r'cannot read the streams in .*none'):
        chosen.command(chosen)


@pytest.mark.parametrize(
    ('enabled', 'strategy', 'expected'),
    [('true', 'Enforce', False), ('true', 'Permissive', True), ('false', 'Permissive', False)],
)
def test_permissive_security_is_noticed(enabled: str, strategy: str, *, expected: bool) -> None:
    environment = {'ROS_SECURITY_ENABLE': enabled, 'ROS_SECURITY_STRATEGY': strategy}
    assert is_unenforced(environment) is expected


def test_the_default_strategy_is_permissive() -> None:
    assert is_unenforced({'ROS_SECURITY_ENABLE': 'true'})
    assert not is_unenforced({})
