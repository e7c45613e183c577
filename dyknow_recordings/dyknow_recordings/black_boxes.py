"""Black boxes: bags that know the formula that failed, and what its states are made of.

The content is JSON in the `custom_data` of the bag's metadata, as base64: the library that writes
YAML folds long texts with backslashes incorrectly. A check of the bag needs nothing else: the
formula has its sorts, and its state stream names the source of each feature.

A bag may begin after the first state of its formula. Then only what holds of any suffix of the
states is a verdict of the formula (`suffix_report`):

    always F, with F about the present and the future    false from a later state: false
    the same formula asked at every state                the verdict from each state
    asked where a trigger begins to hold                 likewise, but at the first state
    with past operators, asked at every state            the verdict from each state from which they
                                                         look back to no state before the suffix
    always F with past operators, in a black box         false from the first such state: false
    eventually[0 s, 5 s] F, always (once[0 s, 5 s] F)    unknown: the states before may decide it
"""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

import yaml

from dyknow_common import (
    NO_CONSTRAINTS,
    DyKnowError,
    ExitCode,
    InlineText,
    Verdict,
    listed,
    round_time,
)
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import (
    Always,
    And,
    Forall,
    Formula,
    Interval,
    first_complete,
    looks_back,
    parse_formula,
    parts,
    walk,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.results import (
    Episode,
    FormulaReport,
    RecordingReport,
    report_of_attempts,
)
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles
from dyknow_recordings.reading.recording import BEGINNING
from dyknow_stream_processing import made, parse_specification

BLACK_BOX: Final = 'dyknow_black_box'
"""The key of the content in the metadata of a bag."""

_METADATA: Final = 'metadata.yaml'


@dataclass(frozen=True, slots=True)
class BlackBoxContent:
    """The metadata of a black box.

    Args:
        name: the name of the formula, for people.
        formula: its canonical text, with all sorts.
        reason: why it was written: `false`, `violation`, `episode` or `request`.
        verdict: the verdict of the running system.
        explanation: the explanation of the verdict, or the error in its place.
        decided_at: the valid time of the deciding state, nanoseconds; None without one.
        every_state: True if the formula was asked at every state.
        margin: True if its margin was computed.
        begin: the valid time of the first state of the formula in the bag; None if it is unknown.
        is_complete: True if the formula had no state before.
        states: the specification of its states.
        constraints: the constraints of its states.
        streams: a text in the stream language for each stream that its states are made of.
        domains: the objects of each sort.
        faults: why a part is missing.
        versions: the versions of the programs.
        configuration: texts that the system was configured with, for people.
    """

    name: str
    formula: str
    reason: str = ''
    verdict: str = ''
    explanation: str = ''
    decided_at: int | None = None
    every_state: bool = False
    margin: bool = False
    begin: int | None = None
    is_complete: bool = False
    states: str = ''
    constraints: str = ''
    streams: Sequence[str] = ()
    domains: Mapping[str, Sequence[str]] = field(default_factory=dict)
    faults: Sequence[str] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    configuration: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The content as a text of JSON."""
        return json.dumps(asdict(self), ensure_ascii=False)

    @property
    def custom_data(self) -> Mapping[str, str]:
        """The content for the metadata of a bag, with texts for people."""
        return {
            BLACK_BOX: b64encode(self.text.encode()).decode(),
            f'{BLACK_BOX}_formula': _plain(self.formula),
            f'{BLACK_BOX}_explanation': _plain(self.explanation),
        }

    @property
    def files(self) -> MonitoringFiles:
        """The inputs of a check of the bag beside the formula.

        Raises:
            DyKnowError: if the constraints are no constraints.
        """
        constraints = NO_CONSTRAINTS
        if self.constraints:
            stated = parse_specification(f'sink states with {self.constraints}')
            constraints = made(stated).constraints
        return MonitoringFiles(
            streams=tuple(InlineText('black box', each) for each in self.streams),
            domains={sort: tuple(objects) for sort, objects in self.domains.items()},
            states=self.states,
            constraints=constraints,
        )

    @property
    def requested(self) -> RequestedFormula:
        """The formula to check."""
        return RequestedFormula(self.formula, self.name)

    @property
    def start(self) -> EpisodeStart:
        """From when the formula is evaluated."""
        every = Every.STATE if self.every_state else Every.FIRST
        formula = parse_formula(self.formula)
        if every is Every.FIRST and not self.is_complete and looks_back(formula):
            every = Every.COMPLETE
        first_state = BEGINNING if self.begin is None else self.begin
        return EpisodeStart(every=every, first_state=first_state)

    def judged(self, report: RecordingReport) -> RecordingReport:
        """Return the results of a check without a verdict that states before the bag may change.

        A note says so if the verdict differs from the running system's.
        """
        (found,) = report.formulas
        if fault := self._missing_streams:
            error = RecordingError(fault, ExitCode.NOT_FOUND)
            return replace(report, formulas=(found.without_verdict(error),))
        begin = found.episodes[0].begin if found.episodes else None
        if not (self.is_complete and begin in {None, self.begin}):
            suffix = 'the black box begins after the first state of the formula'
            found = suffix_report(found, every_state=self.every_state, suffix=suffix)
            report = replace(report, formulas=(found,))
        notes = [*report.notes, *self.faults, *self._difference(found)]
        return replace(report, notes=tuple(notes))

    @property
    def _missing_streams(self) -> str:
        """Why the states of the formula cannot be made; empty if they can."""
        if self.states:
            return ''
        reasons = listed(self.faults) or 'unknown'
        return (
            'the black box does not know the streams of the formula, and so has no verdict '
            f'({reasons}); name the formula and its configuration by options'
        )

    def _difference(self, found: FormulaReport) -> Sequence[str]:
        decided = [each for each in found.episodes if each.verdict is Verdict.FALSE]
        if self.verdict != 'false' or self.decided_at in {each.decided_at for each in decided}:
            return ()
        at = '' if self.decided_at is None else f' at {round_time(self.decided_at)}'
        return (f"the running system decided that '{self.name}' is false{at}",)


def _plain(text: str) -> str:
    return text.replace('\\', '/')


def read_black_box(path: Path) -> BlackBoxContent | None:
    """Return what a bag knows of a formula; None if it is no black box.

    Args:
        path: the path of the folder of the bag, or of its file.

    Raises:
        RecordingError: if the metadata belongs to a black box and is damaged.
    """
    folder = path if path.is_dir() else path.parent
    try:
        text = (folder / _METADATA).read_text(encoding='utf-8')
    except (OSError, ValueError):
        return None
    if BLACK_BOX not in text:
        return None
    try:
        information = yaml.safe_load(text)['rosbag2_bagfile_information']
        if path != folder and path.name not in information['relative_file_paths']:
            return None
        content = json.loads(b64decode(information['custom_data'][BLACK_BOX], validate=True))
        known = {each.name for each in fields(BlackBoxContent)}
        return _checked(BlackBoxContent(**{key: content[key] for key in content if key in known}))
    except (
        yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError,
        DyKnowError,
    ):  # fmt: skip
        raise RecordingError(
            f'{path}: the content of the black box in {_METADATA} is damaged; name its formula and '
            'configuration by options'
        ) from None


def _checked(content: BlackBoxContent) -> BlackBoxContent:
    """Return a content whose values have the types that a check relies on.

    Raises:
        TypeError: if one has not.
    """
    texts = (content.name, content.formula, content.states, content.constraints)
    times = (content.begin, content.decided_at)
    objects = [name for names in content.domains.values() for name in names]
    is_typed = (
        all(isinstance(each, str) for each in (*texts, *content.streams, *content.faults, *objects))
        and all(each is None or type(each) is int for each in times)
        and not isinstance(content.streams, str)
    )
    if not is_typed:
        raise TypeError
    parse_formula(content.formula)
    return content


def is_invariant(formula: Formula) -> bool:
    """Return True if the formula is false whenever it is false from a later state on."""
    match formula:
        case Forall():
            return is_invariant(formula.body)
        case And():
            return is_invariant(formula.left) and is_invariant(formula.right)
        case Always():
            return formula.interval == Interval()
    return False


def lacking_states(formula: Formula, *, every_state: bool) -> str:
    """Return why a part of the states cannot decide a formula; empty if it can.

    Args:
        formula: the formula.
        every_state: True if it is asked at every state.
    """
    if looks_back(formula):
        return 'looks back to earlier states'
    return '' if every_state or is_invariant(formula) else 'depends on its first state'


def suffix_report(
    report: FormulaReport,
    *,
    every_state: bool,
    trigger: str = '',
    suffix: str = 'the recording is cut from another one, which has states before',
) -> FormulaReport:
    """Return the results of a formula over a part of a recording, without unsound verdicts.

    Args:
        report: over the part.
        every_state: True if the formula was asked at every state, or at each that ...
        trigger: ... begins to satisfy this formula.
        suffix: says that there are states before, for the error.
    """
    if report.attempts:
        # Later evaluations begin after the first state.
        first, *later = report.attempts
        found = suffix_report(first.report, every_state=every_state, trigger=trigger, suffix=suffix)
        attempts = [replace(first, report=found), *later]
        return replace(report_of_attempts(attempts), signals=report.signals)
    if report.error is not None and not report.episodes:
        return report  # Perhaps the text is no formula.
    formula = parse_formula(report.formula)
    reason = lacking_states(formula, every_state=every_state)
    if not reason and trigger:
        reason = lacking_states(parse_formula(trigger), every_state=True)
    if not reason:
        return report
    kept, states = _complete_episodes(report, formula, is_every=every_state)
    if states and not trigger:
        event = f'the verdict {reason}: the {states} left out'
        return replace(report, episodes=kept, events=(*report.events, event))
    error = RecordingError(
        f'{suffix}; the verdict {reason}: check a recording from its first state on',
        ExitCode.NOT_FOUND,
    )
    return report.without_verdict(report.error or error)


def _complete_episodes(
    report: FormulaReport, formula: Formula, *, is_every: bool
) -> tuple[tuple[Episode, ...], str]:
    """Return the episodes from which a formula looks back to no state before all.

    Also return the states that are left out; empty if there is no such episode.

    Args:
        report: over a part of a recording.
        formula: its formula.
        is_every: True if there is an episode from every state on.
    """
    found, begins = report.episodes, [each.begin or 0 for each in report.episodes]
    if is_every:
        number = first_complete(formula, begins)
        states = 'first state is' if number == 1 else f'first {number} states are'
        return found[number:], states if found[number:] else ''
    # An invariant begins after the first state if its past is then complete.
    is_sound = is_invariant(formula) and begins and begins[0] != report.first_state
    return found, f'states before {round_time(begins[0])} are' if is_sound else ''


def horizon(formula: str) -> int:
    """Return the time that a verdict about one state looks ahead and back at most, nanoseconds.

    Operators without an end are left out.

    Raises:
        DyKnowError: if it is no formula.
    """
    return _horizon(_body(parse_formula(formula)))


def is_bounded(formula: Formula) -> bool:
    """Return True if each operator has an end in what an invariant says of one state."""
    if isinstance(formula, And):
        return is_bounded(formula.left) and is_bounded(formula.right)
    intervals = (getattr(each, 'interval', None) for each in walk(_body(formula)))
    return all(each.end is not None for each in intervals if isinstance(each, Interval))


def _body(formula: Formula) -> Formula:
    """Return what an invariant says of each state."""
    match formula:
        case Forall():
            return _body(formula.body)
        case Always() if formula.interval == Interval():
            return formula.body
    return formula


def _horizon(part: Any) -> int:
    end = interval.end if isinstance(interval := getattr(part, 'interval', None), Interval) else 0
    found = [_horizon(each) for each in parts(part)]
    if isinstance(part, And):
        return max(found)
    return (end or 0) + max(found, default=0)
