"""The text of a robot.yaml that proposes features, timing and formulas, with explanations."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from pathlib import Path
from typing import Final

from dyknow_common import one_line, round_duration, shortened
from dyknow_configuration.proposals.drafts import FeatureDraft, RobotDraft, draft_robot
from dyknow_configuration.proposals.observations import (
    ObservedTopic,
    SeenValues,
    frame_difference,
    frames_of,
    is_coordinate,
)
from dyknow_configuration.proposals.timing import TopicTiming, timing_of

_PLAIN: Final = re.compile(r'[A-Za-z_/][A-Za-z0-9_/.]*( [A-Za-z0-9_/.]+)*', re.ASCII)
_WORDS_OF_YAML: Final = {'true', 'false', 'yes', 'no', 'on', 'off', 'null'}
_STATUS, _STATUS_TYPE = '/_action/status', 'action_msgs/msg/GoalStatusArray'
_WORD: Final = re.compile(r'(?<=[a-z0-9])(?=[A-Z])')


def robot_text(topics: Iterable[ObservedTopic], origin: str, path: Path, recording: str) -> str:
    """Return a robot.yaml for observed topics.

    Args:
        topics: the topics.
        origin: where they were observed, for people.
        path: of the file, for the examples.
        recording: the arguments of `dyknow check`; empty for a running robot.
    """
    draft = draft_robot(topics)
    used = [each for each in draft.features if not each.reason]
    others = [each for each in draft.features if each.reason]
    parts = [
        _head(origin, path, recording),
        _topics(draft),
        *([_objects(draft)] if draft.objects else []),
        _features(used, others),
        *([positions] if (positions := [*_positions(draft.features)]) else []),
        _formulas(used, draft.topics),
    ]
    return '\n'.join(line.rstrip() for line in chain.from_iterable([*each, ''] for each in parts))


def timing_text(timing: TopicTiming) -> str:
    """Return the measured timing of a topic in a line."""
    found = [f'{timing.rate:.3g} Hz'] if timing.rate else []
    if timing.interval is not None:
        shortest, longest = map(round_duration, (timing.least_interval, timing.greatest_interval))
        found.append(f'intervals of {shortest} to {longest}')
    if timing.delays is not None:
        median, _, _, greatest = map(round_duration, timing.delays)
        found.append(f'delays of {median} (median) to {greatest}')
    else:
        found.append('no stamps')
    return ', '.join(found)


def _head(origin: str, path: Path, recording: str) -> Iterator[str]:
    yield f'# Proposed by dyknow init from {_comment(origin)}.'
    yield '#'
    yield f'#   dyknow lint {path.name}'
    if recording:
        yield f'#   dyknow check {_comment(recording)} --config {path.name}'
    yield f'#   dyknow up {path.name}       starts DyKnow and monitors the formulas'
    yield f'#   dyknow monitor {path.name}  shows them meanwhile, in a table'
    yield '#'
    yield '# Each topic keeps the timing below, also when the computer is busy for a moment.'
    yield '# dyknow suggest proposes narrower bounds.'
    yield '# Each formula holds for all values that were seen: replace its bounds by your own.'


def _topics(draft: RobotDraft) -> Iterator[str]:
    yield '# Observed topics:'
    for each in draft.topics:
        yield f'#   {_comment(each.name)} ({_comment(each.message_type)})'
        messages = f'{each.count} message{"s" * (each.count != 1)}'
        timing = f', {timing_text(timing_of(each.times))}' if each.count else ''
        unknown = 'its message type is not defined here: it was not read'
        yield f'#       {unknown if each.fields is None else messages + timing}'
    if not draft.topics:
        yield '#   none'


def _objects(draft: RobotDraft) -> Iterator[str]:
    yield 'objects:'
    for sort, objects in draft.objects.items():
        yield f'  {sort}: [{", ".join(map(_scalar, objects))}]'


def _features(used: Iterable[FeatureDraft], others: Iterable[FeatureDraft]) -> Iterator[str]:
    yield 'features:'
    for each in used:
        yield from (f'  {line}' for line in _feature(each))
    for each in others:
        yield ''
        yield f'  # Not used: {each.reason}.'
        yield from (f'  # {line}' for line in _feature(each))


def _feature(feature: FeatureDraft) -> Iterator[str]:
    proposal = feature.proposal
    yield f'{_scalar(feature.name)}:'
    if proposal.description:
        yield f'  description: {_scalar(proposal.description)}'
    if feature.domains:
        sorts = ', '.join(f'{variable}: {sort}' for variable, sort in feature.domains.items())
        yield f'  of: {{{sorts}}}'
    if proposal.value_type.value != 'float':
        yield f'  type: {proposal.value_type}'
    if proposal.unit:
        yield f'  unit: {_scalar(proposal.unit)}'
    yield '  from:'
    if values := _values(feature.seen):
        yield f'    # Seen: {values}.'
    yield f'    topic: {_scalar(feature.topic)}'
    yield f'    field: {_scalar(feature.field)}'
    if feature.robots:
        (variable, *_) = feature.domains
        yield f'    only: {{{variable}: [{", ".join(feature.robots)}]}}'
    yield from (f'    {name}: {text}' for name, text in feature.timing.constraints.texts().items())
    for remark in feature.timing.remarks:
        yield f'    # {remark}'


def _positions(features: Iterable[FeatureDraft]) -> Iterator[str]:
    """Yield where the robots are, for regions; each robot has one position."""
    known = {each.topic: each for each in features if is_coordinate(each.field) and each.domains}
    found = [each for each in known.values() if frames_of(each.topics)]
    used = next((each for each in found if _common_frame(each)), None)
    if found:
        yield '# Where the robots are, once there are regions:'
        yield 'positions:' if used else '# positions:'
    for each in found:
        ((variable, sort),) = each.domains.items()
        frames = frames_of(each.topics)
        ((frame, *_), *_) = frames.values()
        source = f'topic: {_scalar(each.topic)}, field: {each.field.rpartition(".")[0]}'
        timing = each.timing.constraints.texts().items()
        source += ''.join(f', {name}: {text}' for name, text in timing)
        if difference := frame_difference(frames):
            yield f'  # In several frames: {_comment(difference)}.'
            frame, source = 'map', f"tf: '{{{variable}}}/base_link'"
        of = f'of: {{{variable}: {sort}}}, frame: {_scalar(frame)}'
        yield f'  {"" if each is used else "# "}- {{{of}, {source}}}'


def _common_frame(feature: FeatureDraft) -> str:
    """Return the frame of the positions of all robots; empty if they have not one."""
    frames = frames_of(feature.topics)
    is_of_all = len(frames) == len(feature.topics) and not feature.robots
    found = {each for several in frames.values() for each in several}
    return found.pop() if is_of_all and len(found) == 1 else ''


def _formulas(used: Iterable[FeatureDraft], topics: Iterable[ObservedTopic]) -> Iterator[str]:
    features = list(used)
    yield 'formulas:'
    for each in features:
        yield f'  - name: {_scalar(_words(each.name))}'
        yield f'    formula: {_scalar(each.ground_formula)}'
        yield '    severity: warning'
    yield from _action_formulas(topics)
    if not features:
        yield '  # - {name: alive, formula: \'always "/topic".field > 0\'}'
    for first, second in pairwise(features):
        if first.domains == second.domains:
            yield '  # An example of what must follow within a time:'
            yield f'  # - name: {_words(second.name)} after {_words(first.name)}'
            yield f'  #   formula: {_scalar(_response(first, second))}'
            return


def _action_formulas(topics: Iterable[ObservedTopic]) -> Iterator[str]:
    for each in topics:
        action = each.name.removesuffix(_STATUS)
        if action != each.name and '{' not in action and each.message_type == _STATUS_TYPE:
            yield '  # Statuses of goals were not compared: one may have been aborted.'
            yield f'  - name: {_scalar(action.strip("/").replace("/", " "))}'
            formula = f'always action("{action}").name != "ABORTED"'
            yield f'    formula: {_scalar(formula)}'
            yield '    severity: warning'


def _response(cause: FeatureDraft, effect: FeatureDraft) -> str:
    """Return a formula: the one of the effect holds soon after the one of the cause does not."""
    beginning, _, expected = cause.ground_formula.partition('always ')
    result = effect.ground_formula.partition('always ')[2]
    return f'{beginning}always (not ({expected}) -> eventually[0 s, 5 s] {result})'


def _values(seen: SeenValues) -> str:
    if seen.texts:
        return _comment(', '.join(sorted(seen.texts)[:5]))
    if seen.least is None:
        return ''
    nan = ', and NaN' if seen.has_nan else ''
    return f'{_number(seen.least)} to {_number(seen.greatest)}{nan}'


def _number(number: float | None) -> str:
    return str(number).lower() if isinstance(number, bool) else f'{number:.4g}'


def _words(name: str) -> str:
    return _WORD.sub(' ', name).lower()


def _comment(text: str) -> str:
    """Return a text without what would end a comment."""
    return ''.join(each if each.isprintable() else '\ufffd' for each in one_line(shortened(text)))


def _scalar(text: str) -> str:
    """Return a text as YAML: plain, in single quotes, or in double quotes with escapes."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS_OF_YAML:
        return text
    return "'" + text.replace("'", "''") + "'" if text.isprintable() else json.dumps(text)
