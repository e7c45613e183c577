"""Explanations of verdicts that peers have reached, in their words.

    "/dyknow/federation/c1/_verdict_5f_1".value = "false: Charge[c1] = 0.05 at 3 s is not > 0.2"
    at 4.000 s starts with "false"

The fact is that a text has come. Its reader wants what it says:

    Charge[c1] = 0.05 at 3 s is not > 0.2
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

PEER_VERDICT: Final = '_verdict_'
"""The first part of the names of streams of verdicts; see `dyknow_federation.push_down`."""

PEER_WAITS: Final = '_waits'
"""The topic of the federation, below its name, with the reasons why verdicts do not come."""

_TEXT: Final = r'"(?:[^"\\]|\\.)*"'
_FACT: Final = (
    rf'"[^"]*/{PEER_VERDICT}\w+"\.value = "(?:true|false): (?:[^"\\]|\\.)*" at \S+ s '
    rf'(?:is not|is equal to|starts with|does not start with) {_TEXT}'
)
_FACTS: Final = re.compile(rf'(; )?({_FACT}(?: and {_FACT})*)(?: \([^()]*\))?', re.DOTALL)
_REASON: Final = re.compile(r'"\.value = "(?:true|false): ((?:[^"\\]|\\.)*)"', re.DOTALL)


_SILENCE: Final = re.compile(
    rf'(?:nobody publishes )?(/\S*/([^/\s]+)/{PEER_VERDICT}\w+)'
    r'(?: any more| has a publisher but no message has come| has fallen silent)?'
)


def with_waits_of_peers(waits_for: str, waits: Mapping[str, str]) -> str:
    """Return why no state comes, with the reasons of peers that evaluate parts of the formula.

    Args:
        waits_for: as the engine reports it: the topics of verdicts are silent.
        waits: why the verdicts of peers do not come, by their topics.
    """

    def reason(found: re.Match[str]) -> str:
        topic, peer = found.groups()
        told = f'waits: {waits[topic]}' if topic in waits else 'has not told how far it is'
        return f"peer '{peer}' {told}"

    return _SILENCE.sub(reason, waits_for)


def with_reasons_of_peers(explanation: str) -> str:
    """Return an explanation in which each verdict of a peer is its reason, once."""
    known: set[str] = set()

    def reasons(facts: re.Match[str]) -> str:
        found = dict.fromkeys(_REASON.findall(facts[2]))
        new = [re.sub(r'\\(["\\])', r'\1', each) for each in found if each not in known]
        known.update(found)
        return (facts[1] or '') + '; '.join(new) if new else ''

    return _FACTS.sub(reasons, explanation)
