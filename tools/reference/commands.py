"""The page of the command dyknow: its verbs and their options."""

import argparse

from reference.markdown import code, page, table

from dyknow_command import options_parser
from dyknow_command.verbs import VERBS

INTRODUCTION = """\
Every verb of `dyknow` with its arguments and options, as `dyknow VERB --help` shows them.
Durations are in seconds unless a unit is given: `30`, `'500 ms'`, `'5 min'`. The exit code is 0
for true or done, 1 for a verdict of false, and 2 for everything else.

`evaluate`, `monitor`, `guard`, `evaluations`, `streams`, `semantics`, `federation`, `dashboard` and
`replay` are one node each, and take `--ros-args` as any ROS node does, such as `dyknow guard
robot.yaml --ros-args -r /cmd_vel:=/base_cmd`. All other verbs refuse it: `up` and `demo` start
several nodes."""


def commands_page():
    """Return the page."""
    verbs = [(f'[`{name}`](#dyknow-{name})', verb.description) for name, verb in VERBS.items()]
    parts = [_verb(name) for name in VERBS]
    return page('Commands', INTRODUCTION, table(('verb', ''), verbs), *parts)


def _verb(name):
    (verbs,) = (
        each
        for each in options_parser(name)._actions  # noqa: SLF001 - there is no other access
        if isinstance(each, argparse._SubParsersAction)  # noqa: SLF001
    )
    parser = verbs.choices[name]
    rows = [
        (_names(each), _help(each, parser))
        for each in parser._actions  # noqa: SLF001
        if not isinstance(each, argparse._HelpAction)  # noqa: SLF001
    ]
    parts = (
        f'## dyknow {name}',
        ' '.join((parser.description or '').split()),
        table(('argument or option', ''), rows),
        f'```\n{parser.epilog}\n```',
    )
    return '\n\n'.join(filter(None, parts))


def _names(action):
    if not action.option_strings:
        return code(_value(action))
    value = '' if action.nargs == 0 else f' {_value(action)}'
    return ', '.join(code(f'{each}{value}') for each in action.option_strings)


def _value(action):
    name = action.metavar or ('|'.join(action.choices) if action.choices else None)
    text = str(name or (action.dest.upper() if action.option_strings else action.dest))
    return {'*': f'[{text} ...]', '+': f'{text} ...', '?': f'[{text}]'}.get(action.nargs, text)


def _help(action, parser):
    return (action.help or '') % {**vars(action), 'prog': parser.prog}
