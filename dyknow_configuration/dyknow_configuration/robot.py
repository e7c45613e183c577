"""The description of a robot and of what is monitored."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import Final

from dyknow_common import (
    NANOSECONDS,
    BlackBoxOptions,
    InlineText,
    Value,
    ValueType,
    format_duration,
)
from dyknow_configuration.expectations import TopicExpectation
from dyknow_configuration.federation import RequestedFederation
from dyknow_configuration.triggers import FormulaTriggers, Trigger
from dyknow_reasoning import NO_CONSTANTS, Constants, FieldReference, parse_formula, walk
from dyknow_space import Region

ParameterValue = bool | int | float | str | list[str]
"""The value of a node's parameter."""

TextSource = Path | InlineText
"""A file, or a text that is not in a file of its own."""


class Severity(StrEnum):
    """The severity of a formula that is false."""

    WARNING = 'warning'
    ERROR = 'error'


@dataclass(frozen=True, slots=True)
class RequestedFormula:
    """A formula to evaluate.

    Args:
        text: the text in the formula language.
        name: the name, for people; empty for its text.
        description: what it says, for people.
        severity: the severity of its violation.
        constants: the values of names that the text does not define.
        every_state: True to ask it at every state.
        margin: True to compute how far it is from the change of its verdict.
        on: what is done when its verdict changes.
        record: the black box that is recorded when it fails; None for none.
    """

    text: str
    name: str = ''
    description: str = ''
    severity: Severity = Severity.WARNING
    constants: Constants = NO_CONSTANTS
    every_state: bool = False
    margin: bool = False
    on: FormulaTriggers = ()
    record: BlackBoxOptions | None = None

    @property
    def closed_text(self) -> str:
        """The text with the constants of the file that it may name."""
        words = {*re.findall(r'\w+', self.text)}
        stated = ', '.join(f'{name} = {value}' for name, value in self.constants if name in words)
        return f'let {stated} in {self.text}' if stated else self.text

    @property
    def streams(self) -> frozenset[str]:
        """The streams and topics whose fields the formula names."""
        parts = walk(parse_formula(self.text, self.constants))
        return frozenset(each.stream for each in parts if isinstance(each, FieldReference))

    def reads(self, topic: str) -> bool:
        """Return True if the formula names a field of a topic."""
        return topic in self.streams


@dataclass(frozen=True, slots=True)
class RequestedGuard:
    """A guard, which passes messages on while its formulas hold.

    Args:
        name: the name of the guard and its node.
        input: the topic of the messages.
        output: the topic on which it passes the messages on.
        formulas: the formulas; all must hold.
        message_type: the type of both topics; empty: the type of the input's publishers.
        safe: the nonzero fields of the message that is sent instead; None: no message is sent.
        period: the time between two safe messages while no message comes, in nanoseconds.
        latch: True if a guard that has closed stays closed until it is reset.
        timeout: the longest time without states, or a sign of life of DyKnow, in nanoseconds.
        place: the place of the guard in its file.
    """

    name: str
    input: str
    output: str
    formulas: tuple[RequestedFormula, ...]
    message_type: str = ''
    safe: Mapping[str, object] | None = field(default_factory=dict)
    period: int = 100 * NANOSECONDS['ms']
    latch: bool = False
    timeout: int = 300 * NANOSECONDS['ms']
    place: str = ''

    def other_names_of_input(self, resolve: Callable[[str], str]) -> Iterator[tuple[str, str]]:
        """Yield each formula that names the input otherwise, with that name.

        It would read what has not passed yet.

        Args:
            resolve: returns the absolute name of a topic.
        """
        for name, stream in self.topics_of_formulas():
            if resolve(stream) == resolve(self.input):
                yield name, stream

    def topics_of_formulas(self) -> Iterator[tuple[str, str]]:
        """Yield the name of each formula with each stream or topic that it names, but the input."""
        for formula in self.formulas:
            for stream in sorted(formula.streams - {self.input}):
                yield formula.name, stream

    def conflict_with(
        self, others: Collection[RequestedGuard], resolve: Callable[[str], str] = str
    ) -> str:
        """Return why this guard cannot run beside others; empty if it can.

        Args:
            others: guards with other names.
            resolve: returns the absolute name of a topic.
        """
        reached = {resolve(self.output)}
        for each in others:
            if resolve(each.output) in reached:
                return (
                    f"the guard '{each.name}' publishes {each.output} already, so what one of them "
                    'stops the other may pass; use one guard with all formulas'
                )
        if resolve(self.input) in reached:
            return 'the output is the input; use another topic'
        while (
            more := {resolve(each.output) for each in others if resolve(each.input) in reached}
            - reached
        ):
            reached |= more
        if resolve(self.input) in reached:
            return (
                f'messages of {self.output} come back to {self.input} by other guards, and pass '
                'again for ever; use another topic'
            )
        return ''


@dataclass(frozen=True, slots=True)
class RobotSort:
    """A sort of objects.

    Args:
        name: its name.
        below: the sort that contains it; empty for none.
        description: for people.
        objects: the objects listed for it, not for sorts below it.
    """

    name: str
    below: str = ''
    description: str = ''
    objects: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RobotFeature:
    """A property of objects, or a relation between them.

    Args:
        name: its name.
        arguments: the sort of each argument, by the name of its variable.
        below: the feature that it is a kind of; empty for none.
        value_type: the value type of its values.
        unit: the unit of its values; empty for none.
        description: for people.
        unknown: if it may be unknown at a state, the least and the greatest value that it may have
            then; infinite for a feature without bounds.
        uncertainty: the stated error of its values, `normal(Height, 0.2)`; empty if exact.
    """

    name: str
    arguments: Mapping[str, str] = field(default_factory=dict)
    below: str = ''
    value_type: ValueType = ValueType.FLOAT
    unit: str = ''
    description: str = ''
    unknown: tuple[float, float] | None = None
    uncertainty: str = ''


PATH_INPUTS: Final[Mapping[str, str]] = {'path_frame': 'header.frame_id', 'path': 'wkt(poses)'}
"""The fields of a planned path (nav_msgs/Path), by the inputs of a forecast."""


@dataclass(frozen=True, slots=True)
class ForecastSource:
    """A topic whose messages a forecast reads.

    Args:
        topic: its name, for some objects.
        inputs: the fields of its messages, by the inputs of the unit.
        path_topic: the path topic of the planned path; empty for none.
    """

    topic: str
    inputs: Mapping[str, str]
    path_topic: str = ''

    @property
    def topics(self) -> tuple[str, ...]:
        """All topics that it reads."""
        return (self.topic, self.path_topic) if self.path_topic else (self.topic,)


@dataclass(frozen=True, slots=True)
class FeatureForecast:
    """The forecast of a feature.

    Args:
        feature: the name of the feature.
        by: the computational unit that makes it.
        horizons: the horizons that `soon` may ask for, in nanoseconds, in ascending order.
        step: the time between the times of the forecast, in nanoseconds; divides all horizons.
        inputs: the fields of the message, by the inputs of the unit, as they are written.
        settings: the settings of the unit.
        table: the file of its calibration; None if none is named.
        unit: the unit of the values in the message; empty for none.
        sources: the topics; none if it is made of a stream.
        widening: the widening of its half-width at each time from now to the last horizon, in
            `unit`; empty if it is not calibrated.
        coverage: the promise of the widening, as the text of a `Coverage`; empty if not known.
    """

    feature: str
    by: str
    horizons: tuple[int, ...]
    step: int
    inputs: Mapping[str, str]
    settings: Mapping[str, Value]
    table: Path | None = None
    unit: str = ''
    sources: tuple[ForecastSource, ...] = ()
    widening: tuple[float, ...] = ()
    coverage: str = ''

    @property
    def steps(self) -> int:
        """The number of times after now until the last horizon."""
        return self.horizons[-1] // self.step

    @property
    def description(self) -> str:
        """All that the widening depends on, as a text."""
        inputs = ', '.join(f'{name} = {path}' for name, path in self.inputs.items())
        settings = {**self.settings, 'step': format_duration(self.step)}
        settings |= {'unit': self.unit} if self.unit else {}
        given = ', '.join(f'{name} = {value}' for name, value in settings.items())
        return f'{self.by}({inputs}), {given}'


class RobotVocabulary:
    """The sorts and features of a robot.

    Args:
        sorts: the sorts by name; each is below an earlier one.
        features: the features by name; each is below an earlier one.
    """

    def __init__(self, sorts: Iterable[RobotSort], features: Iterable[RobotFeature]) -> None:
        self.sorts = {each.name: each for each in sorts}
        self.features = {each.name: each for each in features}

    def __bool__(self) -> bool:
        return bool(self.sorts or self.features)

    def may_be_unknown(self, feature: RobotFeature) -> bool:
        """Return True if a feature may be unknown at a state, or one that it is below."""
        while feature.unknown is None and feature.below:
            feature = self.features[feature.below]
        return feature.unknown is not None

    def with_objects(self, objects: Mapping[str, Sequence[str]]) -> RobotVocabulary:
        """Return the same vocabulary with other objects of some sorts."""
        sorts = (
            replace(each, objects=tuple(objects.get(each.name, each.objects)))
            for each in self.sorts.values()
        )
        return RobotVocabulary(sorts, self.features.values())

    def objects(self, sort: str) -> tuple[str, ...]:
        """Return the objects of a sort and of all sorts below it."""
        below = {sort}
        for each in self.sorts.values():
            if each.below in below:
                below.add(each.name)
        found = (name for each in below for name in self.sorts[each].objects)
        return tuple(dict.fromkeys(sorted(found)))


def choices(domains: Mapping[str, Sequence[str]]) -> Iterator[dict[str, str]]:
    """Yield each choice of an object for each variable, never one object for two of them."""
    for objects in product(*domains.values()):
        if len({*objects}) == len(objects):
            yield dict(zip(domains, objects, strict=True))


@dataclass(frozen=True, slots=True)
class RobotMap:
    """The regions of a robot, and the streams that tell where its objects are.

    Args:
        frame: the frame of the map, which is the first region's; empty without regions.
        regions: the regions that stand still, in all frames, in the order of the file.
        positions: the text of the stream of `x` and `y` of each object, in this frame alone.
        outlines: the text of the stream of the `outline` of each region that moves.
    """

    frame: str = ''
    regions: tuple[Region, ...] = ()
    positions: Mapping[str, str] = field(default_factory=dict)
    outlines: Mapping[str, str] = field(default_factory=dict)

    @property
    def streams(self) -> dict[str, str]:
        """The texts of all streams."""
        return {**self.positions, **self.outlines}


NO_MAP: Final = RobotMap()


@dataclass(frozen=True, slots=True)
class RobotConfiguration:
    """The files, texts and formulas of a system.

    Args:
        ontologies: in OWL.
        annotations: in SSL.
        streams: the streams, in the stream language.
        bridges: rules between the ontologies.
        domains: the objects of sorts for recordings; they take precedence over the objects in the
            ontologies.
        formulas: the formulas to monitor.
        parameters: the parameters of nodes, by the names of nodes and parameters.
        guards: the guards of topics.
        units: the units of features, by name.
        topics: the expectations about topics.
        federation: the federation with other hosts; None: this host has no peers.
        forecasts: the forecasts of features.
        map: the map of its regions.
        triggers: the triggers with names, whether a formula names them or not.
    """

    ontologies: tuple[TextSource, ...] = ()
    annotations: tuple[TextSource, ...] = ()
    streams: tuple[TextSource, ...] = ()
    bridges: tuple[TextSource, ...] = ()
    domains: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    formulas: tuple[RequestedFormula, ...] = ()
    parameters: Mapping[str, Mapping[str, ParameterValue]] = field(default_factory=dict)
    guards: tuple[RequestedGuard, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    topics: tuple[TopicExpectation, ...] = ()
    federation: RequestedFederation | None = None
    forecasts: tuple[FeatureForecast, ...] = ()
    map: RobotMap = NO_MAP
    triggers: tuple[Trigger, ...] = ()
