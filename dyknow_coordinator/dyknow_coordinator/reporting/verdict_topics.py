"""The topics on which the verdicts of named formulas are published: their names and contents.

A topic belongs to one evaluation at a time. While `power` is evaluated, a second evaluation of that
name has the topic `power_2`. When both have ended, the next one continues the topic `power`.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

from dyknow_common import DyKnowError, Margin, Verdict, numbered_names
from dyknow_coordinator.evaluation import EvaluationPhase
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus

MAX_TOKEN: Final = 100
"""The characters of the last part of a topic, without a number."""

_WORDS: Final = re.compile(r'[A-Za-z][A-Za-z0-9]*([ _][A-Za-z0-9]+)*')
_OTHERS: Final = re.compile(r'[^A-Za-z0-9]+')


def verdict_token(name: str) -> str:
    """Return the last part of the topic of a formula, given its name.

    Names of letters, digits and single spaces or underscores differ in their spaces from their
    topics: `no_surge` for `no surge`. Others end with their CRC-32, so that different names have
    different topics: `at_5_m_825db33b` for `at 5 m!`.
    """
    if _WORDS.fullmatch(name) and len(name) <= MAX_TOKEN:
        return name.replace(' ', '_')
    checksum = f'{zlib.crc32(name.encode(errors="surrogatepass")):08x}'
    # ROS has no topic whose name begins with a digit, and hides a topic whose name begins with `_`.
    text = _OTHERS.sub('_', name).lstrip('_0123456789')[: MAX_TOKEN - len(checksum) - 1]
    return f'{text.rstrip("_") or "formula"}_{checksum}'


@dataclass(frozen=True, slots=True)
class NamedVerdict:
    """The state of a named formula; fields as in the FormulaVerdict message.

    Args:
        stamp: valid time of the latest state that is known, in nanoseconds; zero if none is.
        margin: None if it was not asked for.
    """

    stamp: int
    name: str
    verdict: Verdict
    is_violated: bool
    presumably_false: bool
    margin: Margin | None
    error: DyKnowError | None

    @classmethod
    def of(cls, status: EvaluationStatus) -> Self:
        """Return the state of a formula, given the status of its evaluation."""
        verdict, episodes = status.verdict, status.episodes
        is_false = verdict is Verdict.FALSE
        # Verdicts and episodes are reported at once, and the progress each second.
        latest = episodes.latest_episodes[-1:] if episodes is not None else ()
        times = (status.latest_valid_time, status.decided_at, *(each.decided_at for each in latest))
        return cls(
            stamp=max((each for each in times if each is not None), default=0),
            name=status.name,
            verdict=verdict,
            is_violated=is_false if episodes is None else episodes.is_violated,
            presumably_false=is_false or (verdict is not Verdict.TRUE and status.presumably_false),
            margin=status.margin,
            error=status.error,
        )


class VerdictTopicNames:
    """Assigns topics to evaluations.

    Args:
        limit: the number of topics; it may change.

    Attributes:
        without: the names of the evaluations that have no topic because of the limit.
    """

    def __init__(self, limit: int) -> None:
        self.without: tuple[str, ...] = ()
        self.limit = limit
        self._tokens: dict[str, str] = {}
        """The tokens of all evaluations by their keys; empty if another one has taken it over."""
        self._owners: dict[str, str] = {}

    def assign(self, evaluations: Mapping[str, EvaluationStatus]) -> dict[str, EvaluationStatus]:
        """Return the evaluation of each topic, by the last part of its name.

        Args:
            evaluations: the named evaluations that run or ended recently, by unique keys, in the
                order of their requests.
        """
        self._tokens = {key: each for key, each in self._tokens.items() if key in evaluations}
        self._owners = {each: key for each, key in self._owners.items() if key in evaluations}
        without = []
        for key, status in evaluations.items():
            if key not in self._tokens:
                token = self._free_token(status.name, evaluations)
                if token in self._owners or self._make_room(evaluations):
                    self._give(token, key)
                else:
                    without.append(status.name)
        self.without = tuple(without)
        return {token: evaluations[key] for token, key in self._owners.items()}

    def _free_token(self, name: str, evaluations: Mapping[str, EvaluationStatus]) -> str:
        def is_free(token: str) -> bool:
            owner = self._owners.get(token)
            if owner is None:
                return True
            status = evaluations[owner]
            return status.name == name and status.phase is EvaluationPhase.ENDED

        return next(filter(is_free, numbered_names(verdict_token(name))))

    def _make_room(self, evaluations: Mapping[str, EvaluationStatus]) -> bool:
        """Return True if there may be one more topic; one of an ended evaluation makes room."""
        if len(self._owners) < self.limit:
            return True
        for token, key in self._owners.items():
            if evaluations[key].phase is EvaluationPhase.ENDED:
                del self._owners[token]
                self._tokens[key] = ''
                return True
        return False

    def _give(self, token: str, key: str) -> None:
        if token in self._owners:
            self._tokens[self._owners[token]] = ''
        self._owners[token], self._tokens[key] = key, token
