"""The text of a robot.yaml with features and formulas that are proposed for observed topics.

The topics `/uav1/odom` and `/uav2/odom` of the type Odometry are one group, whose features have
the topic `/{u}/odom` for the robots uav1 and uav2. The timing of a group is kept by all of its
topics, and the bounds in its formulas hold for all values that were seen.
"""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain, pairwise
from pathlib import Path
from typing import Final

from dyknow_common import ValueType, one_line, round_duration, shortened
from dyknow_configuration.proposals.message_types import (
    FeatureProposal,
    camel_case,
    proposals_of,
)
from dyknow_configuration.proposals.observations import (
    ObservedTopic,
    SeenValues,
    frame_difference,
    frames_of,
    is_coordinate,
)
from dyknow_configuration.proposals.timing import (
    ProposedTiming,
    TopicTiming,
    proposed_timing,
    timing_of,
    tolerant,
)
from dyknow_configuration.vocabulary import is_free_name
from dyknow_reasoning import FormulaGroup

_NUMBERED: Final = re.compile(r'.*[0-9]')
_STEADY: Final = ('always not {feature}', 'always {feature}')
_LEAST_BOUND: Final = 1e-6
_GREATEST_BOUND: Final = 1e12
_PLAIN: Final = re.compile(r'[A-Za-z_/][A-Za-z0-9_/.]*( [A-Za-z0-9_/.]+)*', re.ASCII)
_WORDS_OF_YAML: Final = {'true', 'false', 'yes', 'no', 'on', 'off', 'null'}
_STATUS, _STATUS_TYPE = '/_action/status', 'action_msgs/msg/GoalStatusArray'
_WORD: Final = re.compile(r'(?<=[a-z0-9])(?=[A-Z])')


@dataclass(frozen=True, slots=True)
class RobotNames:
    """The robots whose names begin the names of topics.

    Args:
        sort: the sort of the robots.
        objects: their names; none if there is a single robot whose topics do not have its name.
    """

    sort: str = 'Robot'
    objects: tuple[str, ...] = ()

    @property
    def variable(self) -> str:
        """The variable for a robot in formulas and topics."""
        return self.sort[0].lower()

    def robot_of(self, topic: str) -> str:
        """Return the robot of a topic; empty if it has none."""
        first, _, rest = topic.lstrip('/').partition('/')
        return first if rest and first in self.objects else ''


def robots_of(topics: Iterable[ObservedTopic]) -> RobotNames:
    """Return the robots whose topics carry features.

    The first part of a topic is a robot if it ends with a number, or if another first part has a
    topic of the same name and type.
    """
    known: dict[str, set[tuple[str, str]]] = defaultdict(set)
    for topic in topics:
        first, _, rest = topic.name.lstrip('/').partition('/')
        if rest and is_free_name(first) and any(proposals_of(topic.message_type, topic.fields)):
            known[first].add((rest, topic.message_type))
    owners: dict[tuple[str, str], list[str]] = defaultdict(list)
    for first, found in known.items():
        for each in found:
            owners[each].append(first)
    shared = {first for each in owners.values() if len(each) > 1 for first in each}
    robots = sorted(each for each in known if each in shared or _NUMBERED.fullmatch(each))
    stems = {camel_case(each.rstrip('0123456789')) for each in robots}
    stem = stems.pop() if len(stems) == 1 else ''
    is_sort = is_free_name(stem) and stem not in robots
    return RobotNames(stem if is_sort else 'Robot', tuple(robots))


@dataclass(frozen=True, slots=True)
class FeatureDraft:
    """A feature with the topics that carry it.

    Args:
        name: the name of the feature.
        proposal: the proposal of its type.
        topics: the topics that carry it.
        topic: the name of the topics, with a variable for the robot.
        field: the field, with a variable for the element, if there is one.
        domains: the sort of each variable.
        robots: the robots that have the topic, if other robots lack it; else empty.
        timing: the timing that all topics keep.
        seen: the values in all topics.
        formula: a formula that all topics satisfy, without quantifiers; empty if there is none.
        reason: why the feature is not used; empty if it is used.
    """

    name: str
    proposal: FeatureProposal
    topics: tuple[ObservedTopic, ...]
    topic: str
    field: str
    domains: Mapping[str, str]
    robots: tuple[str, ...]
    timing: ProposedTiming
    seen: SeenValues
    formula: str
    reason: str

    @property
    def ground_formula(self) -> str:
        """The formula of the feature, for all objects that have it."""
        ranges = ''.join(f'forall {each} in {sort}: ' for each, sort in self.domains.items())
        arguments = f'[{", ".join(self.domains)}]' if self.domains else ''
        owners = ' or '.join(f'{next(iter(self.domains))} = {each}' for each in self.robots)
        ranges += f'{owners} -> ' if owners else ''
        return ranges + self.formula.replace('{feature}', self.name + arguments)


@dataclass(frozen=True, slots=True)
class RobotDraft:
    """Proposals for observed topics.

    Args:
        objects: the objects of each sort.
        features: in the order of their topics.
        topics: all that were observed.
    """

    objects: Mapping[str, tuple[str, ...]]
    features: tuple[FeatureDraft, ...]
    topics: tuple[ObservedTopic, ...]


def draft_robot(topics: Iterable[ObservedTopic]) -> RobotDraft:
    """Return what is proposed for observed topics."""
    ordered = tuple(sorted(topics, key=lambda each: each.name))
    # In a robot.yaml, a brace begins the name of a variable.
    observed = [each for each in ordered if each.count and '{' not in each.name]
    maker = _Maker(robots_of(observed), observed)
    features = tuple(maker.features())
    return RobotDraft(maker.objects, features, ordered)


class _Maker:
    """Makes the features of groups of topics, with names of their own."""

    def __init__(self, robots: RobotNames, topics: Sequence[ObservedTopic]) -> None:
        self._robots = robots
        self._groups: dict[tuple[str, str], list[ObservedTopic]] = {}
        for each in topics:
            self._groups.setdefault((self._shape(each.name), each.message_type), []).append(each)
        self.objects: dict[str, tuple[str, ...]] = {}
        if robots.objects:
            self.objects[robots.sort] = robots.objects
        self._names = {robots.sort, 'Joint', *robots.objects}

    def features(self) -> Iterator[FeatureDraft]:
        """Yield the features; topics with short names first, which have names without prefix."""
        for shape, kind in sorted(self._groups, key=lambda key: (key[0].count('/'), key)):
            topics = self._groups[shape, kind]
            common = [set(proposals_of(kind, each.fields)) for each in topics]
            for proposal in proposals_of(kind, topics[0].fields):
                if all(proposal in each for each in common):
                    yield self._feature(proposal, shape, topics)

    def _shape(self, topic: str) -> str:
        """Return the name of a topic with a variable for its robot."""
        robot = self._robots.robot_of(topic)
        return topic.replace(robot, f'{{{self._robots.variable}}}', 1) if robot else topic

    def _feature(
        self, proposal: FeatureProposal, shape: str, topics: Sequence[ObservedTopic]
    ) -> FeatureDraft:
        domains, owners = {}, tuple(self._robots.robot_of(each.name) for each in topics)
        if owners[0]:
            domains[self._robots.variable] = self._robots.sort
        field, seen = proposal.field, SeenValues()
        for each in topics:
            for path in proposal.read_fields:
                if path in each.values and path.split('[')[0] != proposal.elements:
                    _merge(seen, each.values[path])
        reason = ''
        if proposal.elements:
            variable = 'j' if self._robots.variable != 'j' else 'joint'
            domains[variable] = proposal.element_sort
            field = field.format(f'{{{variable}}}')
            reason = self._add_elements(proposal, topics)
        formula = _formula(proposal, seen)
        return FeatureDraft(
            self._name(proposal, shape),
            proposal,
            tuple(topics),
            shape,
            field,
            domains,
            owners if owners[0] and set(owners) != set(self._robots.objects) else (),
            tolerant(proposed_timing([each.times for each in topics])),
            seen,
            formula,
            reason or _reason(proposal, seen, formula),
        )

    def _add_elements(self, proposal: FeatureProposal, topics: Sequence[ObservedTopic]) -> str:
        """Add the objects of elements, which all topics have; return why there are none."""
        names = [
            {
                text
                for path, seen in each.values.items()
                if path.startswith(f'{proposal.elements}[')
                for text in seen.texts
            }
            for each in topics
        ]
        found = sorted(set.intersection(*names))
        taken = {*self._robots.objects, self._robots.sort}
        if not found or any(not is_free_name(each) or each in taken for each in found):
            return 'its elements have no names, or names that no object can have'
        if self.objects.setdefault(proposal.element_sort, tuple(found)) != tuple(found):
            return 'its elements are others than those of the other topics'
        self._names.update(found)
        return ''

    def _name(self, proposal: FeatureProposal, shape: str) -> str:
        """Return a name that no other feature has."""
        words = [each for each in shape.split('/') if each and '{' not in each]
        last = camel_case(words[-1]) if words else ''
        candidates = [
            proposal.name or last,
            camel_case('_'.join(words)) + proposal.name,
            f'{last or "Topic"}{proposal.name}Value',
        ]
        fallback = (f'{proposal.name or "Value"}{number}' for number in range(2, 10**6))
        for name in (*candidates, *fallback):
            if is_free_name(name) and name not in self._names:
                self._names.add(name)
                return name
        raise AssertionError('the names of features are exhausted')


def _merge(seen: SeenValues, other: SeenValues) -> None:
    seen.add(other.texts)
    seen.add(each for each in (other.least, other.greatest) if each is not None)
    seen.has_nan |= other.has_nan


def _formula(proposal: FeatureProposal, seen: SeenValues) -> str:
    """Return what can be expected, as all values that were seen keep it; empty if nothing."""
    if seen.least is None or seen.greatest is None or seen.has_nan:
        return ''
    if proposal.value_type is ValueType.BOOLEAN and not proposal.formula:
        # What never changed in this time is proposed to stay as it was.
        return _STEADY[bool(seen.least)] if seen.least == seen.greatest else ''
    greatest = max(abs(seen.least), abs(seen.greatest))
    magnitude = _bound(greatest * 1.5, math.ceil) if greatest else '1'
    least = _bound(seen.least / 1.5, math.floor)
    if ('{magnitude}' in proposal.formula and not magnitude) or (
        '{least}' in proposal.formula and not least
    ):
        return ''
    formula = proposal.formula.replace('{magnitude}', magnitude).replace('{least}', least)
    return formula if _is_kept(formula, proposal.value_type, seen) else ''


def _is_kept(formula: str, value_type: ValueType, seen: SeenValues) -> bool:
    """Return True if the extremes of the values keep a formula `always ...`, which bounds them."""
    if not formula:
        return True
    group = FormulaGroup()
    group.add_formula('kept', formula.format(feature='Value'))
    group.begin({})
    convert = bool if value_type is ValueType.BOOLEAN else float
    extremes = enumerate(convert(each) for each in (seen.least, seen.greatest) if each is not None)
    return not any(group.progress(time, {'Value': value}) for time, value in extremes)


def _bound(number: float, direction: Callable[[Decimal], int]) -> str:
    """Return a positive number with two digits, rounded up or down; empty if that is impossible."""
    if not _LEAST_BOUND <= number <= _GREATEST_BOUND:
        return ''
    unit = Decimal(10) ** (math.floor(math.log10(number)) - 1)
    return f'{direction(Decimal(number) / unit) * unit:f}'


def _reason(proposal: FeatureProposal, seen: SeenValues, formula: str) -> str:
    if formula:
        return ''
    if seen.has_nan:
        return 'some of its values were NaN'
    if seen.least is None and not seen.texts:
        return 'no value of it was seen'
    if proposal.formula:
        return 'its values have no bounds that could be proposed, or do not keep the usual ones'
    return 'no formula uses it yet'


def robot_text(topics: Iterable[ObservedTopic], origin: str, path: Path, recording: str) -> str:
    """Return a robot.yaml for observed topics.

    Args:
        topics: the topics.
        origin: where they were observed, for people.
        path: the path of the file, for the examples.
        recording: the arguments of `dyknow check`; empty for a running robot.
    """
    draft = draft_robot(topics)
    used = [each for each in draft.features if not each.reason]
    others = [each for each in draft.features if each.reason]
    formulas = [*_formulas(used, draft.topics)]
    checked = recording if any(not line.lstrip().startswith('#') for line in formulas[1:]) else ''
    parts = [
        _head(origin, path, checked),
        _topics(draft),
        *([_objects(draft)] if draft.objects else []),
        _features(used, others),
        *([positions] if (positions := [*_positions(draft.features)]) else []),
        formulas,
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
        if (first.domains, first.robots) == (second.domains, second.robots):
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
    """Return a formula: soon after the cause's formula fails, the effect's formula holds."""
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
