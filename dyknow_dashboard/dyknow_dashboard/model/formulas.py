"""The formulas that are evaluated or were lately, with the history of their margins.

The coordinator reports an evaluation for some time after its end; the page keeps it longer.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, Final, TypeAlias

from dyknow_common import (
    NANOSECONDS,
    SECOND_NS,
    UNIX_TIMES,
    DyKnowError,
    ExitCode,
    Verdict,
    round_time,
    with_readable_times,
)
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, Level, diagnose
from dyknow_coordinator.reporting.evaluation_status import outcome
from dyknow_dashboard.model.live_reports import strip
from dyknow_reasoning import (
    Always,
    Comparison,
    Eventually,
    Number,
    Probability,
    Until,
    parse_formula,
    walk,
)
from dyknow_recordings.reporting.pictures.timeline import Span

STRIP_NS: Final = 300 * SECOND_NS
"""The time that the verdicts over time are shown for."""

MAX_ENDED: Final = 30
"""The number of evaluations that are kept though the coordinator no longer reports them."""

MAX_SHOWN: Final = 300
"""The number of evaluations that are shown."""

MAX_MARGINS: Final = 600
"""The number of margins that are kept of an evaluation: one for each second."""

GROUPS: Final = ('failing', 'running', 'ended', 'earlier')
"""The groups of evaluations, in the order in which they are shown."""

_FAILED: Final = frozenset({'false', 'error'})
_SILENCE_NS: Final = 5 * SECOND_NS
_MAX_TEXT: Final = 600
"""The number of characters of a text in a row; the details have all of it."""


_TEMPORAL: Final = Always, Eventually, Until

_Bounds: TypeAlias = tuple[int, float, float]
"""A valid time in nanoseconds, and the bounds of a number then."""


@dataclass(slots=True)
class MonitoredEvaluation:
    """An evaluation as the page knows it.

    Args:
        key: identifies it among all evaluations.
        status: the latest one.
        margins: valid time in nanoseconds, and the bounds of the margin.
        probabilities: the same of the probability.
    """

    key: str
    status: EvaluationStatus
    margins: deque[_Bounds] = field(default_factory=lambda: deque(maxlen=MAX_MARGINS))
    probabilities: deque[_Bounds] = field(default_factory=lambda: deque(maxlen=MAX_MARGINS))

    def update(self, status: EvaluationStatus) -> None:
        """Use a later status."""
        self.status = status
        time = status.latest_valid_time
        for known, latest in (
            (self.margins, status.margin),
            (self.probabilities, status.probability),
        ):
            if latest is not None and time is not None and (not known or known[-1][0] < time):
                known.append((time, latest.lower, latest.upper))


class FormulaTable:
    """All evaluations that the page shows: failing, running and ended ones.

    An ended evaluation is an earlier run if one of the same name, started after it, has had a state
    or has ended. These come last, and count as no failure any more.
    """

    def __init__(self) -> None:
        self._known: dict[str, MonitoredEvaluation] = {}
        self._latest: dict[str, tuple[bool, int]] = {}
        """The start of the latest evaluation of each name that has had a state or has ended."""
        self._former: set[tuple[str, int]] = set()
        """The names and starts of evaluations from before simulated time was set back."""
        self._now = 0
        self.version = 0
        self.hidden = 0
        """The number of evaluations that are not shown, as there are too many."""

    def update(self, statuses: Sequence[EvaluationStatus], now: int) -> None:
        """Take a report of the coordinator, of a time in nanoseconds."""
        if now < self._now:
            found = {(each.status.name, each.status.started) for each in self._known.values()}
            self._former = {each for each in found if each[1] > now or each in self._former}
        self._now = now
        self.hidden = max(len(statuses) - MAX_SHOWN, 0)
        known, reported = self._known, dict(keyed(statuses))
        failing_first = sorted(reported.items(), key=lambda each: not _has_failed(each[1]))
        for key, status in failing_first[:MAX_SHOWN]:
            known.setdefault(key, MonitoredEvaluation(key, status)).update(status)
        for key, _ in failing_first[MAX_SHOWN:]:
            known.pop(key, None)
        gone = [key for key in known if key not in reported]
        for key in gone:
            known[key].status = lost(known[key].status)
        for key in gone[: max(len(gone) - MAX_ENDED, 0)]:
            del known[key]
        self._latest = {}
        # Those that are not shown count, too.
        for status in (*statuses, *(each.status for each in known.values())):
            if status.states_progressed or status.phase is EvaluationPhase.ENDED:
                start = self._start(status)
                self._latest[status.name] = max(self._latest.get(status.name, start), start)
        self.version += 1

    def get(self, key: str) -> MonitoredEvaluation | None:
        """Return an evaluation; None if it is not known any more."""
        return self._known.get(key)

    def keys(self) -> list[str]:
        """Return the keys of all evaluations, in the order in which they are shown."""
        return [each.key for each in sorted(self._known.values(), key=self._rank)]

    def by_key(self) -> dict[str, EvaluationStatus]:
        """Return the status of each evaluation, by its key."""
        return {key: each.status for key, each in self._known.items()}

    def statuses(self) -> list[EvaluationStatus]:
        """Return the status of each evaluation, the latest last."""
        found = [each.status for each in self._known.values()]
        return sorted(found, key=lambda status: status.started)

    def running(self) -> list[EvaluationStatus]:
        """Return the status of each evaluation that has not ended."""
        return [each for each in self.statuses() if each.phase is not EvaluationPhase.ENDED]

    def failing(self) -> set[str]:
        """Return the names of the formulas that fail, as the page shows them."""
        found = (each.status for each in self._known.values())
        return {each.name for each in found if self._group(each) == 'failing'}

    def document(self) -> dict[str, Any]:
        """Return a row for each evaluation, and the number of rows of each group."""
        rows = self.rows()
        counts = Counter(each['group'] for each in rows)
        return {
            'rows': rows,
            'counts': {group: counts[group] for group in GROUPS},
            'hidden': self.hidden,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each evaluation."""
        return [self._row(each) for each in sorted(self._known.values(), key=self._rank)]

    def details(self, evaluation: MonitoredEvaluation) -> dict[str, Any]:
        """Return what is shown of an evaluation that is open."""
        status = evaluation.status
        return {
            'name': status.name,
            'explanation': reason_of(status),
            'residual': '' if status.phase is EvaluationPhase.ENDED else status.residual_formula,
            'waits_for': status.waits_for,
            'decided_at': _moment(status.decided_at, status.started),
            'episodes': [] if status.episodes is None else list(_episodes(status)),
            'groundings': [
                {
                    'symbol': each.symbol,
                    'stream': each.stream,
                    'stand_ins': list(each.stand_ins),
                }
                for each in status.groundings
            ],
            'events': [with_readable_times(each, status.started) for each in status.events],
            'margins': list(_since(evaluation.margins, status.started)),
            'probabilities': list(_since(evaluation.probabilities, status.started)),
            'required': [] if not evaluation.probabilities else list(_required(status.formula)),
        }

    def _row(self, evaluation: MonitoredEvaluation) -> dict[str, Any]:
        status = evaluation.status
        diagnosis = diagnose(status, self._now, _SILENCE_NS)
        whole, probability = Span(self._now - STRIP_NS, self._now), status.probability
        return {
            'id': evaluation.key,
            'group': self._group(status),
            'failures': _failures(status),
            'failed_at': _moment(_failed_at(status), status.started),
            'name': _shortened(status.name),
            'formula': _shortened(status.text),
            'plan': _shortened(' / '.join(filter(None, (status.plan, status.action)))),
            'state': outcome(status),
            'kind': _kind(status, diagnosis.level),
            'text': _shortened(
                with_readable_times(
                    diagnosis.text.removeprefix(f'{outcome(status)}: '), status.started
                ).partition('\n')[0]
            ),
            'margin': '' if status.margin is None else str(status.margin),
            'probability': probability and {**probability.document, 'text': str(probability)},
            'states': status.states_progressed,
            'since': max(self._now - status.started, 0) // SECOND_NS,
            'every_state': status.episodes is not None,
            'is_running': status.phase is not EvaluationPhase.ENDED,
            'strip': strip(status, whole),
        }

    def _group(self, status: EvaluationStatus) -> str:
        """Return one of GROUPS."""
        is_ended = status.phase is EvaluationPhase.ENDED
        if is_ended and self._start(status) < self._latest[status.name]:
            return 'earlier'
        if _has_failed(status):
            return 'failing'
        return 'ended' if is_ended else 'running'

    def _start(self, status: EvaluationStatus) -> tuple[bool, int]:
        """Return what is greater for evaluations that began later, whatever the clock was."""
        return (status.name, status.started) not in self._former, status.started

    def _rank(self, evaluation: MonitoredEvaluation) -> tuple[int, int]:
        """Return the place of an evaluation: its group, then the latest failure or end first."""
        status = evaluation.status
        group = self._group(status)
        order = status.started if group == 'running' else -(_failed_at(status) or status.started)
        return GROUPS.index(group), order


def keyed(statuses: Iterable[EvaluationStatus]) -> Iterable[tuple[str, EvaluationStatus]]:
    """Yield evaluations with keys that later reports give them, too."""
    seen: Counter[str] = Counter()
    for each in statuses:
        named = blake2b(f'{each.name}\0{each.formula_text}'.encode(), digest_size=8).hexdigest()
        identity = f'{each.started}-{named}'
        yield f'{identity}-{seen[identity]}', each
        seen[identity] += 1


def lost(status: EvaluationStatus) -> EvaluationStatus:
    """Return the last status of an evaluation that the coordinator reports no more."""
    if status.phase is EvaluationPhase.ENDED:
        return status
    error = DyKnowError(
        'the coordinator no longer reports it: it was restarted, or has ended the evaluation',
        ExitCode.UNAVAILABLE,
    )
    return replace(status, phase=EvaluationPhase.ENDED, error=error)


def _has_failed(status: EvaluationStatus) -> bool:
    return _kind(status, Level.OK) in _FAILED


def _failures(status: EvaluationStatus) -> int:
    """Return how many times a formula has failed."""
    episodes = 0 if status.episodes is None else status.episodes.episode_count
    return episodes or int(_has_failed(status))


def _failed_at(status: EvaluationStatus) -> int | None:
    """Return the valid time of the latest failure of a formula, if it is known."""
    if status.episodes is not None and status.episodes.latest_episodes:
        return status.episodes.latest_episodes[-1].begin
    return status.decided_at if status.verdict is Verdict.FALSE else None


def _kind(status: EvaluationStatus, level: Level) -> str:
    """Return what the colour shows: true, false, error, undecided or warning."""
    word = outcome(status)
    if word in {'true', 'false', 'cancelled'}:
        return {'cancelled': 'undecided'}.get(word, word)
    if word == 'violated':
        return 'false'
    if status.error is not None:
        return 'undecided' if status.error.code is ExitCode.TIMEOUT else 'error'
    if status.episodes is not None and status.episodes.holds and level is Level.OK:
        return 'true'
    return 'undecided' if level is Level.OK else 'warning'


def reason_of(status: EvaluationStatus) -> str:
    """Return why an evaluation has its outcome, for people."""
    text = '' if status.episodes is None else status.episodes.text
    if status.error is not None or status.explanation:
        text = status.explanation if status.error is None else status.error.message
    return with_readable_times(text, status.started)


def _moment(nanoseconds: int | None, start: int) -> dict[str, Any] | None:
    """Return a time as the page shows it: since the start, and on its clock (ms since 1970)."""
    if nanoseconds is None:
        return None
    clock = nanoseconds // NANOSECONDS['ms'] if nanoseconds >= UNIX_TIMES else None
    return {'since': round_time(nanoseconds - start), 'clock': clock}


def _episodes(status: EvaluationStatus) -> Iterable[dict[str, Any]]:
    episodes = () if status.episodes is None else status.episodes.latest_episodes
    for each in reversed(episodes):
        yield {
            'begin': _moment(each.begin, status.started),
            'end': _moment(each.end, status.started) if each.has_ended else None,
            'states': each.states,
            'explanation': with_readable_times(each.text, status.started),
        }


def _since(known: Iterable[_Bounds], started: int) -> Iterator[list[float | None]]:
    for time, lower, upper in known:
        yield [round((time - started) / SECOND_NS, 3), _finite(lower), _finite(upper)]


def _required(formula: str) -> Iterator[dict[str, Any]]:
    """Yield the numbers that probabilities of the future are compared with."""
    for atom in walk(parse_formula(formula)):
        if isinstance(atom, Comparison) and isinstance(atom.left, Probability):
            is_of_future = any(isinstance(each, _TEMPORAL) for each in walk(atom.left))
            if is_of_future and isinstance(atom.right, Number):
                yield {'value': atom.right.value, 'text': f'{atom.operator} {atom.right}'}


def _finite(value: float) -> float | None:
    return float(f'{value:.7g}') if math.isfinite(value) else None


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_TEXT else f'{text[:_MAX_TEXT]}…'
