"""The page of the messages, services and actions: their definitions."""

from pathlib import Path

from reference.markdown import page

FOLDER = Path(__file__).parent.parent.parent / 'dyknow_interfaces'

INTRODUCTION = """\
The definitions of the package `dyknow_interfaces`. In services and actions, `---` separates the
request from the response. Times and durations are messages of `builtin_interfaces`.
[Nodes](nodes.md) lists who serves and publishes them."""

KINDS = {'srv': 'Services', 'action': 'Actions', 'msg': 'Messages'}


def interfaces_page():
    """Return the page."""
    parts = (part for kind, title in KINDS.items() for part in (f'## {title}', *_files(kind)))
    return page('Messages, services and actions', INTRODUCTION, *parts)


def _files(kind):
    for path in sorted((FOLDER / kind).glob(f'*.{kind}')):
        text = path.read_text(encoding='utf-8').strip()
        yield f'### {path.stem}\n\n```\n{text}\n```'


def link(interface):
    """Return the name of a type, with a link to its definition if it is one of ours."""
    *package, name = interface.split('/')
    if package[:1] != ['dyknow_interfaces']:
        return f'`{interface}`'
    return f'[`{name}`](interfaces.md#{name.lower()})'
