"""The episodes of formulas: the states from which each is evaluated, and how each ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import DyKnowError, ExitCode, Margin, Value, Verdict, round_time
from dyknow_coordinator import with_unit
from dyknow_reasoning import (
    ALL_KNOWN,
    FailureEpisode,
    FormulaGroup,
    FormulaProbability,
    FormulaResult,
    ReasoningError,
    UnknownFeatures,
    UnknownValueError,
    first_complete,
    looks_back,
    parse_formula,
    probability_of,
    start_verdicts,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.grounding import GroundedFormula
from dyknow_recordings.evaluation.observation import SignalRecorder
from dyknow_recordings.evaluation.results import Episode, StateGap
from dyknow_recordings.reading.recording import BEGINNING, LostMessages
from dyknow_stream_processing import Violation, rows_of


class Every(StrEnum):
    """The states from which a formula is evaluated."""

    FIRST = 'first'
    """The first one alone."""

    STATE = 'state'
    """Every state."""

    TRIGGER = 'trigger'
    """Every state at which another formula begins to hold."""

    COMPLETE = 'complete'
    """The first one from which the formula looks back to no state before all."""

    @property
    def is_one(self) -> bool:
        """True if it is one state."""
        return self in {Every.FIRST, Every.COMPLETE}


@dataclass(frozen=True, slots=True)
class EpisodeStart:
    """From when formulas are evaluated.

    Args:
        begin: the log time at which the formulas are asked, in nanoseconds since the epoch; states
            that are valid earlier do not count, unless their stamps are of another clock.
        every: which of the others begin an episode.
        trigger: the formula, if `every` is TRIGGER.
        first_state: the valid time of the first state of formulas that were asked before it, in
            nanoseconds; what happens before does not count.
        is_suffix: True if states before the first one are not recorded.
    """

    begin: int = BEGINNING
    every: Every = Every.FIRST
    trigger: str = ''
    first_state: int = BEGINNING
    is_suffix: bool = False


FROM_FIRST_STATE: Final = EpisodeStart()


@dataclass(eq=False)
class FormulaEpisodes:
    """The episodes of one formula.

    Args:
        grounded: the formula.
        every: which states begin an episode.
    """

    grounded: GroundedFormula
    every: Every
    episodes: list[Episode] = field(default_factory=list)
    error: DyKnowError | None = None
    states: int = 0
    first_state: int | None = None
    violations: list[Violation] = field(default_factory=list)
    gaps: list[StateGap] = field(default_factory=list)
    events: list[str] = field(default_factory=list)
    open_episodes: dict[int, int] = field(default_factory=dict)
    """The index in `episodes` of the undecided ones, by the id of the formula."""
    probability: FormulaProbability | None = None
    """The probability of the formula, if it is asked for."""
    begin_is_unknown: bool = False
    """True if its trigger holds at the first state, and states before are not recorded."""
    last_state: int | None = None
    on_end: Callable[[], None] = lambda: None
    """Called when no state can change anything any more."""

    @property
    def has_ended(self) -> bool:
        """True if no state can change anything any more."""
        if self.error is not None:
            return not self.open_episodes
        is_asked_again = not (self.every.is_one and self.episodes)
        awaits = self.probability is not None and not self.probability.is_final
        return not (is_asked_again or self.open_episodes or awaits)

    @property
    def failure(self) -> DyKnowError | None:
        """The error that has ended it; None if it goes on, or has a verdict."""
        single = self.episodes[0].error if self.episodes and self.every.is_one else None
        return (self.error or single) if self.has_ended else None


class EpisodeGroup:
    """The episodes of formulas over the same states.

    Args:
        formulas: with the same features.
        domains: the objects of each sort.
        observer: receives the states.
        unknown: the features that may be unknown at a state.
        is_suffix: True if states before the first one are not recorded.
    """

    last_state: int | None = None
    _states = 0

    def __init__(
        self,
        formulas: Sequence[FormulaEpisodes],
        domains: Mapping[str, tuple[str, ...]],
        observer: SignalRecorder | None = None,
        unknown: UnknownFeatures = ALL_KNOWN,
        *,
        is_suffix: bool = False,
    ) -> None:
        self.formulas = formulas
        self.observer = observer
        self.is_observed_to_end = False
        """True if the observer also receives the states that no formula needs any more."""
        self.has_ended = False
        """True if no state can change anything any more."""
        self._group = FormulaGroup()
        self._standing: dict[FormulaEpisodes, StandingEpisodes] = {}
        self._triggers = {
            each.grounded.trigger: _Trigger(each.grounded.trigger, domains)
            for each in formulas
            if each.every is Every.TRIGGER
        }
        self._unknown = unknown
        self._is_asked_again = any(each.every is not Every.FIRST for each in formulas)
        self._incomplete, self._is_suffix = _IncompleteFormulas(formulas), is_suffix
        self.losses: list[LostMessages] = []
        """The messages that states are missing for."""
        self._owners: dict[int, FormulaEpisodes] = {}
        # The ids of the formulas that have seen no state yet.
        self._fresh: set[int] = set()
        for each in formulas:
            if each.every is Every.FIRST:
                self._open(each)
        self._group.begin(domains, unknown)
        for each in formulas:
            try:
                self._prepare(each, domains)
            except DyKnowError as error:
                self._fail(each, error)
        self._close(self._group.decided_at_once())

    def _prepare(self, each: FormulaEpisodes, domains: Mapping[str, tuple[str, ...]]) -> None:
        grounded, asked = each.grounded, each.grounded.probability
        each.probability = probability_of(asked, domains) if asked else None
        if each.every is Every.STATE:
            self._standing[each] = StandingEpisodes(grounded, domains, self._unknown)
        elif each.every is not Every.FIRST:
            # What past operators look back to is the same from every state.
            self._group.keep_history(grounded.formula)

    def progress(self, valid_time: int, values: Mapping[str, Value]) -> None:
        """Begin the episodes of a state, and progress all of them over it."""
        self._states += 1
        if self._states == 1:
            for each in self.formulas:
                each.first_state = valid_time
        self.last_state = valid_time
        if self.observer is not None:
            columns = {name: (value,) for name, value in values.items()}
            self.observer.states((valid_time,), columns)
        if self._triggers or self._incomplete.formulas:
            self._begin_episodes(valid_time, values)
        for each, standing in self._standing.items():
            if not each.has_ended and (error := standing.progress(valid_time, values)):
                self._fail(each, error)
        for formula_id in self._fresh:
            formula = self._owners[formula_id]
            formula.episodes[formula.open_episodes[formula_id]] = Episode(valid_time)
        self._fresh.clear()
        if self._group.undecided or self._group.keeps_history:
            self._close(self._group.progress(valid_time, values))
        if any(each.probability for each in self.formulas):
            self._step_probabilities(valid_time, values)

    def _step_probabilities(self, valid_time: int, values: Mapping[str, Value]) -> None:
        marked = self._unknown.marked(values, values) if self._unknown else values
        for each in self._running:
            if each.probability is None or each.probability.is_final:
                continue
            try:
                each.probability.step(valid_time, marked)
            except UnknownValueError:
                each.probability.gap()
            except ReasoningError as error:
                self._fail(each, error)
                continue
            if each.has_ended:
                self._end(each)

    def progress_many(
        self, valid_times: NDArray[np.int64], columns: Mapping[str, NDArray[np.generic]]
    ) -> None:
        """Progress over many states, with the same results as one by one.

        Args:
            valid_times: the valid times of the states in nanoseconds, increasing; of shape (n,).
            columns: the values of each feature at these states; of shape (n,).
        """
        start = 0
        is_single = self._is_asked_again or any(each.probability for each in self.formulas)
        if is_single or not all(map(_is_plain, columns.values())):
            start = len(valid_times)
        elif self._fresh:
            start = 1
        single = {name: each[:start] for name, each in columns.items()}
        for time, values in rows_of(valid_times[:start], single):
            if self.has_ended and not self.is_observed_to_end:
                return
            self.progress(time, values)
        if start < len(valid_times) and (self.is_observed_to_end or not self.has_ended):
            self._progress_columns(
                valid_times[start:], {name: each[start:] for name, each in columns.items()}
            )

    def _progress_columns(
        self, valid_times: NDArray[np.int64], columns: Mapping[str, NDArray[np.generic]]
    ) -> None:
        if self.observer is not None:
            self.observer.states(valid_times, columns)
        before, latest = self._states, self.last_state
        results = self._group.progress_many(valid_times, columns) if self._group.undecided else []
        for result in results:
            count = 0
            if result.ended_at is not None:
                count = int(np.searchsorted(valid_times, result.ended_at, 'right'))
            self._states = before + count
            self.last_state = int(valid_times[count - 1]) if count else latest
            self._close([result])
        self._states, self.last_state = before + len(valid_times), int(valid_times[-1])

    def _begin_episodes(self, valid_time: int, values: Mapping[str, Value]) -> None:
        complete = self._incomplete.completed(valid_time)
        rising = {text: each.rises(valid_time, values) for text, each in self._triggers.items()}
        for each in self.formulas:
            if each.has_ended:
                continue
            begins = rising.get(each.grounded.trigger, False)
            if isinstance(begins, DyKnowError):
                self._fail(each, begins)
            elif begins and self._is_suffix and self._states == 1:
                each.begin_is_unknown = True
            elif begins or each in complete:
                self._open(each)

    def gap(self, after: int) -> None:
        """Record that states may be missing after one that is valid at a time, nanoseconds."""
        self._group.gap()
        for trigger in self._triggers.values():
            trigger.gap()
        for standing in self._standing.values():
            standing.gap()
        if self.observer is not None:
            self.observer.gap()
        for each in self._running:
            each.gaps.append(StateGap(after, None))
            if each.probability is not None:
                each.probability.gap()
                if each.has_ended:
                    self._end(each)

    def end_gap(self, before: int) -> None:
        """Record the valid time of the first state after a gap, in nanoseconds."""
        for each in self._running:
            if each.gaps:
                each.gaps[-1] = replace(each.gaps[-1], before=before)

    def lose(self, lost: LostMessages, *, is_final: bool) -> None:
        """Note that states are missing after the latest one, or before the first.

        Args:
            lost: the messages that they would be made of.
            is_final: True if other states may be wrong, too: then the formulas fail.
        """
        self.losses.append(lost)
        for trigger in self._triggers.values():
            trigger.lose()
        for each in self._running:
            is_first_lost = each.open_episodes.keys() & self._fresh or (
                not self._states and _looks_back(each.grounded)
            )
            if is_final or is_first_lost:
                self._fail(each, self._loss())

    def _loss(self) -> RecordingError:
        more = f' (and {len(self.losses) - 1} more)' if len(self.losses) > 1 else ''
        return RecordingError(
            f'the verdict depends on {self.losses[0]}{more}', ExitCode.CONSTRAINT_VIOLATION
        )

    def _with_loss(self, error: DyKnowError) -> DyKnowError:
        """Return an error that also names the messages that are lost."""
        if not self.losses or error.message == self._loss().message:
            return error
        return RecordingError(f'{error.message}; {self._loss().message}', error.code)

    def add_violation(self, violation: Violation) -> None:
        """Record a violation in the streams of the states."""
        for each in self._running:
            each.violations.append(violation)

    def add_event(self, event: str) -> None:
        """Record a change of the streams of the states."""
        for each in self._running:
            each.events.append(event)

    def fail(self, error: DyKnowError) -> None:
        """End all episodes with an error."""
        for each in self._running:
            self._fail(each, error)

    def finish(self) -> None:
        """Record what remains of the undecided episodes: errors, if messages are lost."""
        for each in self._running:
            if not (self.losses or each.begin_is_unknown):
                continue
            is_standing = each in self._standing
            found = self._standing[each].episodes() if is_standing else each.episodes
            if all(episode.verdict is not Verdict.FALSE for episode in found):
                self._fail(each, self._loss() if self.losses else _unknown_begin(each))
        for each in self.formulas:
            if not each.has_ended:
                each.states, each.last_state = self._states, self.last_state
                if each in self._standing:
                    each.episodes = self._standing[each].episodes()
            for formula_id, index in each.open_episodes.items():
                each.episodes[index] = Episode(
                    each.episodes[index].begin,
                    residual_formula=self._group.residual(formula_id),
                    presumably_false=self._group.presumably_false(formula_id),
                    margin=_margin_of(each, self._group.margin(formula_id)),
                    wants=tuple(self._group.wants(formula_id).items()),
                )

    def _open(self, formula: FormulaEpisodes) -> None:
        text = formula.grounded.formula
        formula_id = self._group.add_formula(text, text, margin=formula.grounded.margin)
        formula.open_episodes[formula_id] = len(formula.episodes)
        formula.episodes.append(Episode(None))
        self._owners[formula_id] = formula
        self._fresh.add(formula_id)

    def _close(self, results: Iterable[FormulaResult]) -> None:
        for result in results:
            formula = self._owners.pop(result.formula_id)
            index = formula.open_episodes.pop(result.formula_id)
            formula.episodes[index] = Episode(
                formula.episodes[index].begin,
                result.verdict,
                result.decided_at,
                result.explanation,
                result.error and self._with_loss(result.error),
                objects=result.objects,
                windows=result.windows,
                margin=_margin_of(formula, result.margin),
            )
            if self.observer is not None and result.decided_at is not None:
                self.observer.decided(result.decided_at)
            self._forget(result.formula_id)
            if formula.has_ended:
                self._end(formula)

    def _fail(self, formula: FormulaEpisodes, error: DyKnowError) -> None:
        formula.error = error = self._with_loss(error)
        if formula in self._standing:
            formula.episodes = self._standing[formula].episodes(error)
        for formula_id, index in formula.open_episodes.items():
            margin = _margin_of(formula, self._group.margin(formula_id))
            begin = formula.episodes[index].begin
            formula.episodes[index] = Episode(begin, error=error, margin=margin)
            del self._owners[formula_id]
            self._forget(formula_id)
        formula.open_episodes.clear()
        self._end(formula)

    @property
    def _running(self) -> list[FormulaEpisodes]:
        return [each for each in self.formulas if not each.has_ended]

    def _end(self, formula: FormulaEpisodes) -> None:
        formula.states, formula.last_state = self._states, self.last_state
        self.has_ended = all(each.has_ended for each in self.formulas)
        formula.on_end()

    def _forget(self, formula_id: int) -> None:
        self._fresh.discard(formula_id)
        self._group.remove_formula(formula_id)


class _IncompleteFormulas:
    """The formulas that wait for a state from which they look back to none before all."""

    def __init__(self, formulas: Iterable[FormulaEpisodes]) -> None:
        waiting = [each for each in formulas if each.every is Every.COMPLETE]
        self.formulas = {each: parse_formula(each.grounded.formula) for each in waiting}
        self._valid_times: list[int] = []

    def completed(self, valid_time: int) -> Sequence[FormulaEpisodes]:
        """Return the formulas that wait no longer, as there is another state."""
        if not self.formulas:
            return ()
        times = self._valid_times
        times.append(valid_time)
        parsed = self.formulas.items()
        found = [each for each, formula in parsed if first_complete(formula, times) < len(times)]
        for each in found:
            del self.formulas[each]
        return found


class _Trigger:
    """A formula that each state decides by itself, and the states at which it begins to hold."""

    def __init__(self, text: str, domains: Mapping[str, tuple[str, ...]]) -> None:
        self._text = text
        self._group = FormulaGroup()
        self._group.begin(domains)
        with suppress(ReasoningError):  # `rises` refuses a trigger that looks into the future.
            self._group.keep_history(text)
        self._held = False

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._group.gap()
        self.lose()

    def lose(self) -> None:
        """Record that it may have begun to hold at a state that is missing."""
        self._held = True

    def rises(self, valid_time: int, values: Mapping[str, Value]) -> bool | DyKnowError:
        """Return True if it holds now and did not before; its error if it has no verdict."""
        formula_id = self._group.add_formula(self._text, self._text)
        results = self._group.progress(valid_time, values) or self._group.decided_at_once()
        self._group.remove_formula(formula_id)
        if not results:
            return RecordingError(
                f"the trigger '{self._text}' is not decided by one state; leave out always, "
                'eventually and until'
            )
        (result,) = results
        if result.error is not None:
            return result.error
        held, self._held = self._held, result.verdict is Verdict.TRUE
        return self._held and not held


def _unknown_begin(formula: FormulaEpisodes) -> RecordingError:
    return RecordingError(
        f'the recording is cut from another one, which has states before; the trigger '
        f"'{formula.grounded.trigger}' holds at the first state, so it may have begun to hold "
        'before: check the other one',
        ExitCode.NOT_FOUND,
    )


def _looks_back(grounded: GroundedFormula) -> bool:
    """Return True if a verdict may depend on states before the first of its episode."""
    texts = filter(None, [grounded.formula, grounded.trigger])
    return any(looks_back(parse_formula(each)) for each in texts)


def _margin_of(formula: FormulaEpisodes, margin: Margin | None) -> Margin | None:
    """Return a margin in its unit."""
    return None if margin is None else with_unit(margin, formula.grounded.units)


def _is_plain(column: NDArray[np.generic]) -> bool:
    """Return True for numbers and booleans, but for a column with a NaN."""
    return column.dtype.kind in 'biu' or (column.dtype.kind == 'f' and not np.isnan(column).any())


class StandingEpisodes:
    """The episodes of one formula, one for each state, by one standing monitor.

    Args:
        grounded: the formula.
        domains: the objects of each sort.
        unknown: the features that may be unknown at a state.
    """

    def __init__(
        self,
        grounded: GroundedFormula,
        domains: Mapping[str, tuple[str, ...]],
        unknown: UnknownFeatures,
    ) -> None:
        self._group = FormulaGroup()
        self._units, text, margin = grounded.units, grounded.formula, grounded.margin
        formula_id = self._group.add_formula(text, text, margin=margin, every_state=True)
        self._group.begin(domains, unknown)
        self._formula = self._group.standing.formulas[formula_id]
        self._log = self._formula.monitor.keep_all()
        self._margins = self._formula.margins
        if self._margins is not None:
            self._margins.keep_all()
        self._times: list[int] = []
        self._left_out: list[int] = []
        """The states that the monitor leaves out: one of several values decides the formula."""

    def progress(self, valid_time: int, values: Mapping[str, Value]) -> DyKnowError | None:
        """Begin an episode and progress all; return the error by which the formula fails."""
        before = self._formula.monitor.states
        results = self._group.progress(valid_time, values)
        is_left_out = self._formula.monitor.states == before
        (self._left_out if is_left_out else self._times).append(valid_time)
        return results[0].error if results else None

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._group.gap()

    def episodes(self, error: DyKnowError | None = None) -> list[Episode]:
        """Return the episodes; undecided ones have the error, if there is one."""
        monitor = self._formula.monitor
        states = self._times[: monitor.states]
        failures = {each.begin: each for each in self._formula.episodes(len(states))}
        found: list[Episode] = []
        latest: FailureEpisode | None = None
        verdicts = start_verdicts(monitor, self._log, states)
        for time, each, margin in zip(states, verdicts, self._margins_of(states), strict=True):
            latest = failures.get(time, latest)
            is_undecided = each.verdict is Verdict.UNDECIDED
            is_first = each.verdict is Verdict.FALSE and time in failures
            found.append(
                Episode(
                    time,
                    each.verdict,
                    each.decided_at,
                    _explanation(each.verdict, latest, is_first=is_first),
                    each.error or (error if is_undecided else None),
                    residual_formula=each.residual_formula,
                    presumably_false=each.presumably_false,
                    objects=latest.objects if latest and is_first else '',
                    margin=margin,
                    wants=tuple(each.wants.items()),
                )
            )
        unknown = (*self._times[monitor.states :], *self._left_out)
        found += [Episode(time, error=error) for time in unknown]
        return sorted(found, key=lambda each: each.begin or 0)

    def _margins_of(self, states: Sequence[int]) -> list[Margin | None]:
        if self._margins is None:
            return [None] * len(states)
        found = self._margins.of_each()[: len(states)]
        return [with_unit(each, self._units) for each in found]


def _explanation(verdict: Verdict, latest: FailureEpisode | None, *, is_first: bool) -> str:
    """Return the reason for a verdict: in full for the first of consecutive false ones."""
    if verdict is not Verdict.FALSE or latest is None:
        return ''
    return latest.explanation if is_first else f'as from {round_time(latest.begin)} on'
