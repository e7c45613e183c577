"""Parsing of formulas to their abstract syntax."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, get_args

from lark import Token

from dyknow_common import (
    FUNCTIONS,
    DyKnowError,
    PositionedError,
    SyntaxBuilder,
    TextPosition,
    builder,
    check_unit,
    comparison_value,
    duration_value,
    message_constant,
    number_value,
    parse_duration,
    shortened,
)
from dyknow_reasoning.language import formula as syntax
from dyknow_reasoning.language import sugar, terms
from dyknow_reasoning.language.constants import (
    NO_CONSTANTS,
    Constant,
    Constants,
    Units,
    constants_of,
    literal_of,
    with_uncertain_features,
    without_lets,
)
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.functions import (
    FIELD_FUNCTIONS,
    OBJECT_FUNCTIONS,
    check_call,
    field_reference,
    function_of_field,
    not_a_function,
    with_numbers,
)
from dyknow_reasoning.language.grammar import LANGUAGE
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.quantities import with_converted_numbers
from dyknow_reasoning.language.soon import without_soon
from dyknow_reasoning.language.spatial import (
    DistanceInterval,
    LinkEnd,
    LinkLength,
    Over,
    Spatial,
    compared_number,
)
from dyknow_reasoning.language.symbols import resolve, with_links
from dyknow_reasoning.language.terms import Term
from dyknow_reasoning.language.type_checking import check_limits

_MAX_KEPT: Final = 1000
"""The length of a text whose abstract syntax is kept: one formula is often asked for again."""


def parse_formula(text: str, constants: Constants = NO_CONSTANTS) -> Formula:
    """Return the abstract syntax of a formula.

    A name without arguments is a variable within the reach of its quantifier. Elsewhere it is an
    object if it is an argument of a feature somewhere in the formula, or is compared by `=` or `!=`
    with a variable or an object; else it is a feature without arguments.

    Constants are replaced by their values. Numbers with a unit are converted to the units of
    features, where `let` states these; otherwise they remain.

    Args:
        text: the formula.
        constants: the values of names that the text does not define.

    Raises:
        LanguageError: with the position, for a text that is not a formula.
    """
    return _parse(text, constants)[0]


def parse_constants(texts: Mapping[str, str]) -> Constants:
    """Return constants, given the text of each value: `150 W`.

    Raises:
        LanguageError: naming the constant that has no such name or value.
    """
    found: list[tuple[str, Constant]] = []
    for name, value in texts.items():
        text = f'let {name} = {value} in true'
        with LANGUAGE.errors_in(text):
            found += constants_of(LANGUAGE.parse(text, _FormulaBuilder(())), name)
    return tuple(found)


def stated_units(text: str, constants: Constants = NO_CONSTANTS) -> Units:
    """Return the units of features and references that the text of a formula states by `let`.

    Raises:
        LanguageError: for a text that is not a formula.
    """
    return _parse(text, constants)[1]


def _parse(text: str, constants: Constants) -> tuple[Formula, Units]:
    return (_parse_again if len(text) <= _MAX_KEPT else _parse_once)(text, constants)


def _parse_once(text: str, constants: Constants) -> tuple[Formula, Units]:
    with LANGUAGE.errors_in(text):
        formula = _shallow(_formula(LANGUAGE.parse(text, _FormulaBuilder(constants))))
        formula, units, uncertainties = without_lets(formula, constants)
        LANGUAGE.check_depth(formula, syntax.parts)
        check_limits(formula)
        formula = with_uncertain_features(without_soon(formula), uncertainties)
        LANGUAGE.check_depth(formula, syntax.parts)
        resolved: Formula = with_numbers(resolve(with_converted_numbers(formula, units)))
        return with_links(resolved), units


_parse_again = lru_cache(1024)(_parse_once)


def _shallow(node: Any) -> Any:
    """Return a formula or a term over which functions may recurse."""
    with suppress(PositionedError):
        LANGUAGE.check_depth(node, _parts)
        return node
    LANGUAGE.check_depth(node, syntax.flat_parts)
    found = syntax.balanced(node)
    LANGUAGE.check_depth(found, _parts)
    return found


def _parts(node: Formula | Term) -> tuple[Formula | Term, ...]:
    """Return the parts of a node, also what `let` gives to names."""
    stated = (*node.constants, *node.uncertainties) if isinstance(node, syntax.Let) else ()
    return (*syntax.parts(node), *(value for _, value in stated))


@lru_cache
def definition_of(relation: str) -> Any:
    """Return the syntax of what a relation of two objects, r and s, stands for."""
    return LANGUAGE.parse(sugar.SPATIAL[relation], _FormulaBuilder(NO_CONSTANTS))


def _shown(node: Formula | Term) -> str:
    """Return the text of a node for a message."""
    LANGUAGE.check_depth(node, syntax.parts)
    return shortened(node)


def _formula(node: Formula | Term) -> Formula:
    match node:
        case _ if isinstance(node, terms.NumericTerm | terms.Covariance):
            raise PositionedError(
                f"'{_shown(node)}' is a number, not a formula; compare it with another",
                node.position,
            )
        case terms.TextLiteral():
            raise PositionedError(
                f'{_shown(node)} is a string, not a formula; compare it with another', node.position
            )
        case terms.ValueBefore():
            raise PositionedError(
                f"'{_shown(node)}' is a value, not a formula; compare it with another, or write "
                f"'previous {_shown(node.body)}'",
                node.position,
            )
        case (
            terms.Object() | terms.Variable() | terms.Kept()
        ):  # pragma: no cover - never an operand here
            raise PositionedError(f"'{_shown(node)}' is an object, not a formula", node.position)
        case _:
            return node


def _term(node: Formula | Term) -> Term:
    if isinstance(node, Term):
        return node
    if isinstance(node, terms.Covariance):
        raise PositionedError(f"'{_shown(node)}' stands in normal(...) only", node.position)
    raise PositionedError(
        f"'{_shown(node)}' is a formula, not a value; join formulas with '<->', 'and', 'or'",
        node.position,
    )


def _state_count(body: Formula | Term, window: Formula | Term) -> terms.StateCount:
    formula = _formula(body)
    if syntax.looks_forward(formula):
        raise PositionedError(
            f"'{_shown(formula)}' looks into the future; 'count' counts states so far",
            formula.position,
        )
    return terms.StateCount(formula, Interval(0, _time_of('count', window)))


def _time_of(name: str, window: Formula | Term) -> int:
    """Return the time that is an operand of a function, in nanoseconds."""
    match window:
        case terms.Number(value):
            raise PositionedError(
                f"the time {value} of '{name}' has no unit; write {value} s if it is in seconds",
                window.position,
            )
        case terms.Quantity(value, unit):
            text = f'{value} {unit}'
        case _:
            text = _shown(window)
    try:
        time = parse_duration(text)
    except ValueError as error:
        raise PositionedError(str(error), window.position) from None
    if time < 0:
        message = f"the time {text} of '{name}' is negative; write a duration from 0 s on"
        raise PositionedError(message, window.position)
    return time


def _uncertain(
    name: str, first: Formula | Term, second: Formula | Term, *others: Any
) -> terms.Uncertain | terms.Covariance:
    estimate, amount = _term(first), _term(second)
    if name == 'within':
        return terms.Bounded(estimate, amount)
    if name == 'sampled':
        return terms.Sampled(estimate, amount)
    if name == 'covariance':
        if isinstance(amount, terms.Quantity):
            raise PositionedError('a covariance is a plain number; remove its unit', first.position)
        return terms.Covariance(name, estimate, amount, position=first.position)
    covariances = tuple(each for each in others if isinstance(each, terms.Covariance))
    time, *more = [each for each in others if each not in covariances] or [None]
    for each in more:
        message = f"'{_shown(each)}' is a second time constant; leave it out"
        raise PositionedError(message, each.position)
    constant = None if time is None else _time_of(name, time)
    return terms.Uncertain(estimate, amount, constant, covariances)


def _whole(token: Token) -> int:
    number = number_value(token)
    if isinstance(number, float):
        raise PositionedError(
            f"a count is compared with a whole number, not '{token}'", TextPosition.of(token)
        )
    return number


def _unit_text(token: Token) -> str:
    unit = token[1:-1] if token.type == 'STRING' else str(token)
    try:
        check_unit(unit)
    except DyKnowError as error:
        is_long = token.type == 'UNIT' and not unit.isalpha()
        hint = '; if only a part of it is the unit, put that in double quotes' if is_long else ''
        raise PositionedError(f'{error.message}{hint}', TextPosition.of(token)) from None
    return unit


def _quantifier(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(_: object, _word: Token, *parts: Any) -> Formula:
        *variables, body = parts
        formula = _formula(body)
        for variable, sort in reversed(variables):
            formula = kind(variable, sort, formula)
        return formula

    return build


_OPERATORS: Final[Mapping[str, Callable[..., Formula]]] = {
    **{kind.symbol: kind for kind in get_args(syntax.FutureFormula | syntax.PastFormula)},
    'not_': syntax.Not,
    'and_': syntax.And,
    'or_': syntax.Or,
    'implies': syntax.Implies,
    'equivalent': syntax.Equivalent,
    'holds_until': sugar.holds_until,
    'unless': sugar.unless,
    'release': sugar.release,
}
"""The operators by their rules: temporal ones by their words."""

_NO_OPERANDS: Final = Token | Interval | None
"""The other children of the rules of operators: words and intervals."""


@builder
class _FormulaBuilder(SyntaxBuilder[Any]):
    """The builder of the abstract syntax: unbound names are features, arguments are objects.

    Args:
        constants: the values of names, also of constants of recorded message types.
    """

    def __init__(self, constants: Constants) -> None:
        super().__init__()
        self._constants = dict(constants)

    forall = _quantifier(syntax.Forall)
    exists = _quantifier(syntax.Exists)

    def __default__(self, rule: str, children: Sequence[Any], meta: Any) -> Formula:
        """Build an operator over formulas."""
        operands = [_formula(each) for each in children if not isinstance(each, _NO_OPERANDS)]
        intervals = [each for each in children if isinstance(each, Interval)]
        is_infix = len(operands) > 1
        position = operands[0].position if is_infix else TextPosition.of(meta)
        return _OPERATORS[rule](*operands, *intervals, position=position)

    def variable(self, name: Token, sort: Token | None) -> tuple[str, str]:
        return str(name), str(sort or f'?{name}')

    def count(
        self,
        words: Token,
        number: Token,
        variable: Token,
        sort: Token | None,
        body: Formula | Term,
    ) -> Formula:
        bound = syntax.CountBound(' '.join(words.split()))
        named = str(variable), str(sort or f'?{variable}')
        return syntax.Count(*named, _formula(body), bound, _whole(number))

    def soon(self, word: Token, horizon: Token, body: Formula | Term) -> Formula:
        if not (duration := duration_value(horizon)):
            raise PositionedError(
                "the time of 'soon' is 0; write how far to look ahead", TextPosition.of(horizon)
            )
        return syntax.Soon(duration, _formula(body), position=TextPosition.of(word))

    def count_of(self, words: Token, number: Token, *members: Formula | Term) -> Formula:
        bound = syntax.CountBound(' '.join(words.split()))
        return syntax.CountOf(bound, _whole(number), tuple(map(_formula, members)))

    def constant(self, name: Token, value: Formula | Term) -> tuple[terms.Object, Any]:
        return terms.Object(str(name), position=TextPosition.of(name)), _shallow(value)

    def unit(self, name: Token, unit: Token) -> tuple[terms.Object, str]:
        text = str(name if name.type == 'NAME' else self.reference(name))
        # A feature without a unit is a pure number.
        found = _unit_text(unit) if unit != '""' else ''
        return terms.Object(text, position=TextPosition.of(name)), found

    def let(self, *children: Any) -> Formula:
        *bindings, body = children
        units = tuple(each for each in bindings if isinstance(each[1], str))
        uncertain = tuple(each for each in bindings if isinstance(each[1], terms.Uncertain))
        constants = tuple(each for each in bindings if each not in units + uncertain)
        return syntax.Let(constants, units, _formula(body), uncertain)

    def uncertainty(
        self, name: Token, value: Formula | Term
    ) -> tuple[terms.Object, terms.Uncertain]:
        if not isinstance(value, terms.Uncertain):
            message = (
                f"what is known of '{name}' is normal({name}, DEVIATION) or within({name}, ERROR)"
            )
            raise PositionedError(message, value.position)
        return terms.Object(str(name), position=TextPosition.of(name)), _shallow(value)

    def distance(self, number: Token, unit: Token | None) -> tuple[int | float, Token | None]:
        return number_value(number), unit

    def distances(
        self, opening: Token, first: Any, _: Token, last: Any, closing: Token
    ) -> DistanceInterval:
        given = [each for each in (first, last) if isinstance(each, tuple)]
        units = {str(unit or '').strip('"') for value, unit in given if unit or value}
        named, counts = units - {''}, units & {'hop', 'hops'}
        hops = bool(named) and named == counts
        if (not hops and (counts or (named and '' in units))) or (
            hops and any(isinstance(value, float) for value, _ in given)
        ):
            message = 'give both distances a unit, or count whole links: [0, 50 m], [1, 3 hops]'
            raise PositionedError(message, TextPosition.of(opening))
        ends: list[Any] = [
            terms.Number(value) if hops or unit is None else terms.Quantity(value, _unit_text(unit))
            for value, unit in given
        ]
        start, end = (*ends, None)[:2]
        return DistanceInterval(start, end, opening + closing, hops)

    def spatial(self, word: Token, distances: DistanceInterval, body: Formula | Term) -> Formula:
        return Spatial(str(word), distances, None, _formula(body))

    def reach(
        self,
        left: Formula | Term,
        word: Token,
        distances: DistanceInterval,
        right: Formula | Term,
    ) -> Formula:
        operands = _formula(left), _formula(right)
        return Spatial(str(word), distances, *operands, position=left.position)

    def surround(
        self,
        left: Formula | Term,
        _: Token,
        distances: DistanceInterval,
        right: Formula | Term,
    ) -> Formula:
        return sugar.surround(_formula(left), _formula(right), distances, left.position)

    def delaunay(self, x: Formula | Term, y: Formula | Term) -> tuple[Term, ...]:
        return _term(x), _term(y)

    def links(self, *children: Any) -> LinkEnd:
        *link, weight, first, second, sort = children
        place: tuple[Term, ...] = link.pop(0) if isinstance(link[0], tuple) else ()
        condition = _formula(link[0]) if link and link[0] else terms.Truth(True)
        length = compared_number(condition) if weight is None else _term(weight)
        end = LinkEnd(str(second), str(sort), LinkLength(condition, length, place))
        return LinkEnd(str(first), str(sort), end)

    def over(self, links: LinkEnd, origin: Token, place: Token, body: Formula | Term) -> Formula:
        start = terms.Object(str(origin), position=TextPosition.of(origin))
        return Over(str(place), links.sort, _formula(body), links, start)

    def comparison(self, left: Formula | Term, operator: Token, right: Formula | Term) -> Formula:
        symbol = comparison_value(operator)
        return syntax.Comparison(symbol, _term(left), _term(right), position=left.position)

    def arithmetic(self, left: Formula | Term, operator: Token, right: Formula | Term) -> Term:
        symbol = '*' if operator.type == 'TIMES' else str(operator)
        return terms.Arithmetic(symbol, _term(left), _term(right), position=left.position)

    def power(self, base: Formula | Term, exponent: Formula | Term) -> Term:
        return terms.Function('pow', (_term(base), _term(exponent)), position=base.position)

    def negative(self, minus: Token, operand: Formula | Term) -> Term:
        if isinstance(operand, terms.Number | terms.Quantity):
            return replace(operand, value=-operand.value, position=TextPosition.of(minus))
        return terms.Arithmetic('-', terms.Number(0), _term(operand))

    def number(self, token: Token) -> Term:
        return terms.Number(number_value(token))

    def quantity(self, number: Token, unit: Token) -> Term:
        return terms.Quantity(number_value(number), _unit_text(unit))

    def call(self, name: Token, *arguments: Formula | Term) -> Term | terms.Covariance:
        if len(arguments) == 1 and name in FIELD_FUNCTIONS:
            return function_of_field(name, _shallow(arguments[0]))
        if name == 'count' and len(arguments) == 2:  # noqa: PLR2004 - a formula and a time
            return _state_count(*arguments)
        check_call(name, len(arguments))
        if name == 'P':
            return terms.Probability(_formula(arguments[0]))
        if name in {'normal', 'within', 'sampled', 'covariance'}:
            return _uncertain(name, *arguments)
        if name == 'prev':
            return terms.ValueBefore(_term(arguments[0]))
        return terms.Function(str(name), tuple(map(_term, arguments)))

    def aggregate(
        self, name: Token, body: Formula | Term, variable: Token, sort: Token | None
    ) -> Term:
        if name not in OBJECT_FUNCTIONS:
            message = f"'{name}' takes no 'for'; {', '.join(OBJECT_FUNCTIONS)} do"
            raise PositionedError(message, TextPosition.of(name))
        if name != 'count':
            body = _term(body)
        elif not isinstance(body, syntax.StateAtom):
            message = f"'{_shown(body)}' is no comparison and no boolean feature, as 'count' needs"
            raise PositionedError(message, body.position)
        return terms.Aggregate(str(variable), str(sort or f'?{variable}'), body, str(name))

    def text(self, token: Token) -> Term:
        return terms.TextLiteral(re.sub(r'\\(.)', r'\1', token[1:-1]))

    def true(self, _word: Token) -> Formula:
        return terms.Truth(True)

    def false(self, _word: Token) -> Formula:
        return terms.Truth(False)

    def reference(self, token: Token) -> Term:
        if token in self._constants:
            return self._constants[str(token)]
        try:
            value = message_constant(token)
        except DyKnowError as error:
            raise PositionedError(error.message, TextPosition.of(token)) from None
        return field_reference(token) if value is None else literal_of(value)

    def name(self, token: Token) -> Formula | Term:
        return self.feature(token, ())

    def feature(self, token: Token, arguments: tuple[terms.Object, ...]) -> Formula | Term:
        if token in FUNCTIONS:
            raise not_a_function(token)
        if token in sugar.SPATIAL and len(arguments) == 2:  # noqa: PLR2004 - two objects
            given = dict(zip('rs', arguments, strict=True))
            return sugar.spatial(definition_of(str(token)), given, TextPosition.of(token))
        return terms.Feature(str(token), arguments)

    def arguments(self, *tokens: Token) -> tuple[terms.Object, ...]:
        return tuple(terms.Object(str(token), position=TextPosition.of(token)) for token in tokens)

    def interval(
        self, opening: Token, first: Token, _: Token, last: Token, closing: Token
    ) -> Interval:
        start = duration_value(first) + (opening == '(')
        if last.type == 'INFINITY':
            return Interval(start, None)
        end = duration_value(last) - (closing == ')')
        if end < start:
            written = f'{opening}{first}, {last}{closing}'
            raise PositionedError(
                f"the interval '{written}' is empty; it must end after it begins",
                TextPosition.of(opening),
            )
        return Interval(start, end)
