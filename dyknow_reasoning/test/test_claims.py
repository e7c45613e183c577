"""Each claim of an explanation, checked against the states by a naive reading."""

from __future__ import annotations

import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import COMPARISONS, begun, formulas, holds, with_history

from dyknow_common import Value, Verdict
from dyknow_reasoning import parse_formula
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Exists,
    Forall,
    Formula,
    Or,
    PastFormula,
    Until,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Feature,
    Number,
    Object,
    TextLiteral,
    Truth,
    Variable,
)

SECOND = 1_000_000_000

States = Sequence[tuple[int, Mapping[str, Value]]]

TIME = r'(-?\d+\.\d{3,9}) s'
VALUE = r'(true|false|".*?"|[-\d.einf]+)'
FACT = re.compile(
    rf'(?P<left>\S+) = {VALUE} at {TIME} is (?P<negated>not )?(?P<operator>[<>]=? |equal to |)'
    rf'(?:(?P<right>\S+) = )?{VALUE}'
)
FLAG = re.compile(rf'(?P<name>\S+) is (true|false) at {TIME}')
STATE = re.compile(rf'there is a state at {TIME}')
SPAN = rf'in (?P<opens>[\[(]){TIME}, {TIME}(?P<closes>[\])])'
HELD = re.compile(rf"'(?P<formula>.*)' held at (?P<which>every|no) state {SPAN}")
NO_STATE = re.compile(rf'there was no state {SPAN}')
PAST = re.compile(
    r"(?:'(?P<formula>[^']*)' (?P<how>held at a|held at no|held at every|did not hold at every)|"
    rf'there was no) state (?:(?P<opens>from|after) {TIME} |up )?(?P<closes>to|before) {TIME}'
    r"(?: since when '(?P<left>[^']*)' has held)?"
)
BEFORE = re.compile(rf"'(?P<formula>.*)' held at the state before {TIME}")
NOT_BEFORE = re.compile(rf"there is no state just before {TIME} at which '(?P<formula>.*)' held")
PAST_FLAG = re.compile(rf"'(?P<formula>.*)' is (?P<value>true|false) at {TIME}")
CERTAIN = re.compile(r"'.*' is (true|false) whatever states follow")
ALL = re.compile(r'for all (\d) objects of S, decided last for (.*)')
AND = re.compile(r" and (?=(?:[^']*'[^']*')*[^']*$)")
DUE = re.compile(
    r'(?P<reasons>.*) \((?P<operator>not until|until|always|eventually)(?P<interval>[\[(].*[\])])? '
    rf'(?P<due>must hold|awaited) since {TIME}\)'
)


@dataclass(frozen=True)
class Judge:
    """Checks claims about a formula that the last of some states decides."""

    formula: Formula
    states: States
    verdict: bool

    def check(self, explanation: str) -> None:
        for sentence in re.sub(r'; and \d+ more$', '', explanation).split('; '):
            self.check_reason(sentence)

    def check_reason(self, sentence: str) -> None:
        if found := DUE.fullmatch(sentence):
            for reason in AND.split(found['reasons']):
                self.check_reason(reason)
            self.check_due(found['operator'], found['interval'], nanoseconds(found[5]))
        elif self.is_about_the_past(sentence):
            pass
        elif found := HELD.fullmatch(sentence):
            times = self.within(found)
            assert times, 'no state'
            if found['formula'].endswith('...'):
                return
            formula = parse_formula(found['formula'])
            forbidden = found['which'] == 'no'
            assert all(holds(formula, self.states, i) is not forbidden for i in times)
        elif found := NO_STATE.fullmatch(sentence):
            assert not self.within(found)
        elif found := CERTAIN.fullmatch(sentence):
            assert (found[1] == 'true') == self.verdict
        else:
            self.check_fact(sentence)

    def is_about_the_past(self, sentence: str) -> bool:  # noqa: PLR0911
        """A claim about a past operator at the last state."""
        last = len(self.states) - 1
        if not any(isinstance(part, PastFormula) for part in walk(self.formula)):
            return False
        if '...' in sentence:  # A formula that was cut.
            return True
        if found := PAST.fullmatch(sentence):
            return self.is_true_of_the_past(found)
        if found := BEFORE.fullmatch(sentence):
            self.values_at(found[2])
            return holds(parse_formula(found['formula']), self.states, last - 1) is True
        if found := NOT_BEFORE.fullmatch(sentence):
            self.values_at(found[1])
            formula = parse_formula(found['formula'])
            return not last or holds(formula, self.states, last - 1) is False
        if found := PAST_FLAG.fullmatch(sentence):
            self.values_at(found[3])
            value_ = found['value'] == 'true'
            return holds(parse_formula(found['formula']), self.states, last) is value_
        return False

    def is_true_of_the_past(self, found: re.Match[str]) -> bool:
        formula, left = (
            parse_formula(found['formula'] or 'true'),
            parse_formula(found['left'] or 'true'),
        )
        begins, ends = found.group(4), nanoseconds(found.group(6))
        first = nanoseconds(begins) + (found['opens'] == 'after') if begins else float('-inf')
        held = [
            all(holds(each, self.states, k) is True for each, k in self.claimed(formula, left, i))
            for i, (time, _) in enumerate(self.states)
            if first <= time <= ends - (found['closes'] == 'before')
        ]
        return {
            None: not held,
            'held at a': any(held),
            'held at no': not any(held),
            'held at every': all(held),
            'did not hold at every': not all(held),
        }[found['how']]

    def claimed(self, right: Formula, left: Formula, i: int) -> list[tuple[Formula, int]]:
        """The truth of both sides that makes `left since right` hold through state i."""
        return [(right, i), *((left, k) for k in range(i + 1, len(self.states) - 1))]

    def check_fact(self, sentence: str) -> None:
        """A claim about the last state."""
        if found := FACT.fullmatch(sentence):
            values = self.values_at(found[3])
            left = self.shown(found['left'], found[2], values)
            right = self.shown(found['right'], found[7], values)
            claimed = COMPARISONS.get(found['operator'].strip(), operator.eq)
            assert claimed(left, right) == (not found['negated'])
            actual = value(found['right'] or found[7], values)
            left_actual = value(found['left'], values)
            assert claimed(left_actual, actual) == (not found['negated'])
            assert (left == right) == (left_actual == actual)
        elif found := FLAG.fullmatch(sentence):
            assert self.values_at(found[3])[found['name']] is (found[2] == 'true')
        else:
            found = STATE.fullmatch(sentence)
            assert found, f'not understood: {sentence}'
            self.values_at(found[1])

    def values_at(self, time: str) -> Mapping[str, Value]:
        assert self.states[-1][0] == nanoseconds(time)
        return self.states[-1][1]

    def shown(self, name: str | None, text: str, values: Mapping[str, Value]) -> Any:
        """The printed value, after a check that it is the state's."""
        printed = value(text, values)
        if name is not None:
            actual = value(name, values)
            assert type(actual) is type(printed)
            assert actual == printed or actual == pytest.approx(printed, rel=1e-8)
        return printed

    def within(self, found: re.Match[str]) -> list[int]:
        """The states that a span contains."""
        first, last = (nanoseconds(time) for time in found.groups()[-3:-1])
        first, last = first + (found['opens'] == '('), last - (found['closes'] == ')')
        return [i for i, (time, _) in enumerate(self.states) if first <= time <= last]

    def check_due(self, word: str, interval: str | None, since: int) -> None:
        """A claim that this state decides an operator that an earlier state reached."""
        [index] = [i for i, (time, _) in enumerate(self.states) if time == since]
        assert index < len(self.states) - 1
        kinds = {'always': (Always, Eventually, Until), 'eventually': (Always, Eventually, Until)}
        decided = [
            part
            for part in walk(self.formula)
            if isinstance(part, kinds.get(word, (Until,)))
            and (interval is None or str(part.interval) == interval)
            and holds(part, self.states[:-1], index) is None
            and decided_by_the_last(part, self.states, index)
        ]
        assert decided, f'nothing is due since {since}'


def decided_by_the_last(formula: Formula, states: States, start: int) -> bool:
    """Return True if the last state decides a formula from a start on, which looks back to all."""
    group = with_history(str(formula))
    results = []
    for index, (time, values) in enumerate(states):
        if index == start:
            group.add_formula('it', str(formula))
        results += group.progress(time, values)
    return [result.decided_at for result in results] == [states[-1][0]]


def nanoseconds(text: str) -> int:
    seconds, _, decimals = text.removeprefix('-').partition('.')
    found = int(seconds) * SECOND + int(decimals.ljust(9, '0'))
    return -found if text.startswith('-') else found


def value(text: str, values: Mapping[str, Value]) -> Any:
    if text in values:
        return values[text]
    if text in {'true', 'false'}:
        return text == 'true'
    if text.startswith('"'):
        return text[1:-1]
    return float(text) if set(text) & set('.ein') else int(text)


def grounded(node: Any, domain: Sequence[str], binding: Mapping[str, str]) -> Any:
    """A formula without quantifiers, and without true and false for nothing."""
    again = partial(grounded, domain=domain)
    match node:
        case Forall(variable, _, body) | Exists(variable, _, body):
            is_all = isinstance(node, Forall)
            made: Formula = Truth(is_all)
            for name in domain:
                made = (And if is_all else Or)(
                    made, again(body, binding={**binding, variable: name})
                )
            return made
        case Variable(name):
            return Object(binding[name])
    return with_changed_parts(node, partial(again, binding=binding))


U = (Variable('u'),)
ATOMS: tuple[Formula, ...] = (
    Feature('p', U),
    Feature('p', U),
    Feature('q'),
    Comparison('=', Feature('x', U), Number(0.3)),
    Comparison('<', Number(0.3), Feature('x', U)),
    Comparison('<=', Feature('x', U), Feature('y')),
    Comparison('!=', Feature('m'), TextLiteral('off')),
    Truth(True),
)

NUMBERS = (0.3, 0.1 + 0.2, 0.30000000001, 7, -1e-20, 0.30000001192092896)


def states(names: Sequence[str], steps: st.SearchStrategy[int]) -> st.SearchStrategy[States]:
    values: dict[str, st.SearchStrategy[Value]] = {
        'q': st.booleans(),
        'y': st.sampled_from(NUMBERS),
        'm': st.sampled_from(['on', 'off']),
    }
    for name in names:
        values |= {f'p[{name}]': st.booleans(), f'x[{name}]': st.sampled_from(NUMBERS)}
    rows = st.lists(st.tuples(steps, st.fixed_dictionaries(values)), min_size=1, max_size=12)
    return rows.map(
        lambda found: [
            *zip(accumulate(step for step, _ in found), (v for _, v in found), strict=True)
        ]
    )


BODIES = formulas(3, st.sampled_from(ATOMS))
DOMAINS = ((), ('a',), ('a', 'b'))
TRACES = {
    domain: st.one_of(states(domain, st.just(1)), states(domain, st.integers(1, 5)))
    for domain in DOMAINS
}


@st.composite
def cases(draw: Any) -> tuple[Formula, Sequence[str], States]:
    body = draw(BODIES)
    domain = draw(st.sampled_from(DOMAINS))
    quantifier = draw(st.sampled_from([Forall, Exists]))
    formula = quantifier('u', 'S', body)
    if draw(st.booleans()):
        formula = draw(st.sampled_from([Always, Eventually]))(formula)
    return formula, domain, draw(TRACES[domain])


def judged(formula: Formula, domain: Sequence[str], trace: States) -> str | None:
    """Check the explanation, and return it; None if the formula stays undecided."""
    group, _ = begun(str(formula), {'S': domain})
    if group.decided_at_once():
        return None
    for length, (time, values) in enumerate(trace, 1):
        for result in group.progress(time, values):
            assert result.error is None, result.error
            verdict = result.verdict is Verdict.TRUE
            whole = parse_formula(str(formula))
            why = result.explanation
            judge = Judge(grounded(whole, domain, {}), trace[:length], verdict)
            if found := re.fullmatch(r'for none of (\d) objects of S, decided last: (.*)', why):
                assert (verdict, int(found[1])) == (False, len(domain))
                why = found[2]
            if found := ALL.fullmatch(why):
                assert (verdict, int(found[1])) == (True, len(domain))
                instances = [of_instance(whole, name) for name in domain]
                held = [holds(grounded(each, domain, {}), trace[:length], 0) for each in instances]
                assert False not in held
                why = f'for {found[2]}'
            if found := re.fullmatch(r'for u = (\w+): (.*)', why):
                instance = of_instance(whole, found[1])
                assert holds(grounded(instance, domain, {}), trace[:length], 0) in {verdict, None}
                judge, why = (
                    Judge(grounded(instance, domain, {}), trace[:length], verdict),
                    found[2],
                )
            judge.check(why)
            return result.explanation
    return None


def of_instance(formula: Any, name: str) -> Any:
    match formula:
        case Forall(variable, _, body):
            return grounded(body, [], {variable: name})
    return with_changed_parts(formula, partial(of_instance, name=name))


@given(cases())
def test_every_claim_is_true(case: tuple[Formula, Sequence[str], States]) -> None:
    judged(*case)


def test_what_is_due_looks_back_to_all_states() -> None:
    formula = parse_formula('eventually eventually[1 ns, 2 ns] once[0, 4 ns] p')
    trace = [(time, {'p': time == 1}) for time in (1, 4, 5)]
    assert judged(formula, (), trace[:1]) is None
    assert judged(formula, (), trace) == (
        "'p' held at a state from 0.000000001 s to 0.000000005 s "
        '(eventually(0 s, 2 ns] awaited since 0.000000004 s)'
    )
