"""The page of the Python API: signatures and docstrings of the classes that programs use."""

import inspect
import re
from enum import Enum

from reference.markdown import page

import dyknow_common
import dyknow_coordinator
import dyknow_coordinator.ros
import dyknow_reasoning
import dyknow_recordings
import dyknow_stream_processing
import dyknow_stream_processing.ros

API = {
    'Formulas over a running system': (
        (dyknow_coordinator.ros, ('FormulaClient', 'Monitor', 'PlanMonitor')),
        (dyknow_coordinator, ('Answer', 'Progress', 'Plan', 'PlanAction', 'PlanFormula', 'Holds')),
        (dyknow_common, ('Verdict', 'ExitCode', 'DyKnowError', 'Margin')),
    ),
    'Streams in a node': (
        (dyknow_stream_processing.ros, ('StreamProxy',)),
        (dyknow_common, ('StreamConstraints',)),
        (dyknow_stream_processing, ('Sample', 'Violation')),
    ),
    'Formulas over states of a program, without ROS': (
        (dyknow_reasoning, ('FormulaGroup', 'FormulaResult', 'parse_formula', 'check_trace')),
    ),
    'Recordings, without ROS': (
        (dyknow_recordings, ('open_recording', 'evaluate_recording', 'RecordingReport')),
    ),
}

INTRODUCTION = """\
What programs import, with its docstrings. [Clients](../clients.md),
[formulas](../formulas.md) and [streams](../streams.md) show how to use it. Times are integers in
nanoseconds unless a name or a docstring says otherwise."""

WIDTH = 90
RECEIVERS = {'self', 'cls'}

_SECTION = re.compile(r'^(Args|Returns|Raises|Attributes|Yields):$', re.MULTILINE)
_ITEM = re.compile(r'^ {4}(\w+)( \([^)]*\))?: ', re.MULTILINE)


def python_page():
    """Return the page."""
    parts = []
    for title, members in API.items():
        parts.append(f'## {title}')
        for module, names in members:
            parts.extend(_member(module.__name__, getattr(module, name)) for name in names)
    return page('Python API', INTRODUCTION, *parts)


def _member(module, member):
    name = member.__name__
    parts = [
        f'### {name}',
        f'```python\nfrom {module} import {name}\n```',
        *_described(name, member),
    ]
    if inspect.isclass(member):
        for each, attribute in vars(member).items():
            if not each.startswith('_') and _is_documented(attribute):
                parts.extend((f'#### {name}.{each}', *_described(each, attribute)))
    return '\n\n'.join(filter(None, parts))


def _is_documented(attribute):
    inner = getattr(attribute, 'fget', None) or getattr(attribute, '__func__', attribute)
    return inspect.isfunction(inner) and bool(inspect.getdoc(attribute))


def _described(name, member):
    yield f'```text\n{_signature(name, member)}\n```'
    yield _text(inspect.getdoc(member) or '')


def _signature(name, member):
    """Return a signature, on one line or with one parameter a line."""
    if inspect.isclass(member) and issubclass(member, Enum):
        return '\n'.join(f'{name}.{each.name} = {each.value!r}' for each in member)
    if isinstance(member, property):
        return f'{name}: {inspect.signature(member.fget).return_annotation}'
    function = getattr(member, '__func__', member)
    signature = inspect.signature(function)
    parameters = [each for each in signature.parameters.values() if each.name not in RECEIVERS]
    texts = [_parameter(each) for each in parameters]
    keywords = [each.kind is inspect.Parameter.KEYWORD_ONLY for each in parameters]
    if True in keywords:
        texts.insert(keywords.index(True), '*')
    prefix = 'async ' if inspect.iscoroutinefunction(function) else ''
    result = '' if inspect.isclass(member) else f' -> {signature.return_annotation}'
    text = f'{prefix}{name}({", ".join(texts)}){result}'
    if len(text) <= WIDTH:
        return text
    lines = ''.join(f'    {each},\n' for each in texts)
    return f'{prefix}{name}(\n{lines}){result}'


def _parameter(parameter):
    stars = {parameter.VAR_POSITIONAL: '*', parameter.VAR_KEYWORD: '**'}.get(parameter.kind, '')
    text = stars + parameter.name
    if parameter.annotation is not parameter.empty:
        text += f': {parameter.annotation}'
    if parameter.default is parameter.empty:
        return text
    return f'{text} = {_default(parameter.default)}'


def _default(value):
    """Return a default as a text that is the same in each run."""
    if isinstance(value, Enum):
        return f'{type(value).__name__}.{value.name}'
    if isinstance(value, (str, int, float, tuple, type(None))):
        return repr(value)
    return '...'


def _text(docstring):
    """Return a docstring in Markdown: its sections as lists."""
    text = _SECTION.sub(r'\n**\1**\n', docstring)
    text = _ITEM.sub(r'- `\1`\2: ', text)
    return re.sub(r'\n{3,}', '\n\n', re.sub(r'^ {8}', '  ', text, flags=re.MULTILINE)).strip()
