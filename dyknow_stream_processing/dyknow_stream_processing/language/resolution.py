"""Resolution of the names in a specification, and checks of its fields and types."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from dyknow_common import (
    MAX_DEPTH,
    NO_CONSTRAINTS,
    ArrayElements,
    DyKnowError,
    ExitCode,
    StreamConstraints,
    TextPosition,
    ValueType,
    absence,
    element_fields,
    field_type,
    listed_as,
    shortened,
    value_text,
    with_article,
)
from dyknow_stream_processing.language import specification as syntax
from dyknow_stream_processing.language.built_in_sources import built_in_fields, type_fault
from dyknow_stream_processing.language.sinks import made
from dyknow_stream_processing.language.specification import Specification, Term
from dyknow_stream_processing.language.term_sizes import MAX_FIELDS, TermSizes
from dyknow_stream_processing.language.type_rules import (
    Unit,
    collision_text,
    comparable_types,
    fits,
    interpolated,
    setting_fault,
    settings,
)

Fields = Mapping[str, ValueType | None]
"""The fields of a stream with their types; `None` for a type that is not known."""

_TypedTerm = tuple[Term, Fields | None]


@dataclass(frozen=True, slots=True)
class FreeNames:
    """The names that a specification refers to and does not declare.

    Args:
        streams: names of streams, written as identifiers.
        topics: names of topics, written in quotes.
    """

    streams: frozenset[str]
    topics: frozenset[str]


@dataclass(frozen=True, slots=True)
class Resolved:
    """A stream whose references are all to topics.

    Args:
        term: its definition.
        fields: the fields of its samples; `None` if they are not known.
        names: the names, in the specification, of the streams it is made of, by canonical text.
    """

    term: Term
    fields: Fields | None
    names: Mapping[str, str]


def free_names(specification: Specification) -> FreeNames:
    """Return the streams and topics that a specification refers to and does not declare."""
    streams = {each.name for each in specification.declared(syntax.StreamDeclaration)}
    sources = {each.name for each in specification.declared(syntax.SourceDeclaration)}
    found = [
        reference
        for each in specification.declarations
        if isinstance(each, syntax.StreamDeclaration | syntax.SinkDeclaration)
        for reference in syntax.references(each.stream)
    ]
    return FreeNames(
        frozenset(each.name for each in found if not each.is_topic) - streams - sources,
        frozenset(each.name for each in found if each.is_topic) - sources,
    )


def resolve(
    specification: Specification,
    constraints: StreamConstraints,
    streams: Mapping[str, Resolved],
    topic_fields: Callable[[str], Fields | None],
    units: Mapping[str, Unit],
) -> Resolved:
    """Return the stream that a specification makes.

    Args:
        specification: the specification.
        constraints: are added to the stream's.
        streams: the streams that an identifier may refer to, besides the declared ones.
        topic_fields: returns the fields of a topic; `None` if they are not known.
        units: the existing computational units, by name.

    Raises:
        LanguageError: with the position, for an unknown name, for fields, types and constraints
            that do not fit, and for a stream that is too large.
        DyKnowError: if the added constraints contradict the specification's.
    """
    resolver = _Resolver(specification, streams, topic_fields, units)
    for each in specification.declared(syntax.StreamDeclaration):
        resolver.stream(each)
    term, fields = resolver.made(made(specification))
    merged = term.constraints.merged(constraints)
    term, fields = resolver.expiring(replace(term, constraints=merged), fields, term.position)
    return Resolved(term, fields, resolver.names)


class _Resolver:
    """The resolution of one specification; each declared stream is resolved once."""

    def __init__(
        self,
        specification: Specification,
        streams: Mapping[str, Resolved],
        topic_fields: Callable[[str], Fields | None],
        units: Mapping[str, Unit],
    ) -> None:
        self.names: dict[str, str] = {}
        self._existing = streams
        self._topic_fields = topic_fields
        self._units = units
        self._error = specification.error
        self._streams = {
            each.name: each for each in specification.declared(syntax.StreamDeclaration)
        }
        self._sources = {
            each.name: each for each in specification.declared(syntax.SourceDeclaration)
        }
        self._calls = {each.name: each for each in specification.declared(syntax.UnitDeclaration)}
        self._resolved: dict[str, _TypedTerm] = {}
        self._pending: list[str] = []
        self._used: set[str] = set()
        self._sizes = TermSizes()
        self._check_declared_once(specification.declarations)

    def stream(self, declaration: syntax.StreamDeclaration) -> _TypedTerm:
        """Return a declared stream and its fields."""
        name = declaration.name
        if name in self._pending:
            cycle = ' -> '.join([*self._pending[self._pending.index(name) :], name])
            raise self._error(f"stream '{name}' is made from itself: {cycle}", declaration.position)
        if name not in self._resolved:
            if len(self._pending) == MAX_DEPTH:
                message = f"stream '{name}' is at the end of more than {MAX_DEPTH} streams, "
                message += 'one made from the other; declare fewer'
                raise self._error(message, declaration.position)
            self._pending.append(name)
            self._resolved[name] = self.term(declaration.stream)
            self._pending.pop()
            self._add_name(name, self._resolved[name][0], declaration.position)
        return self._resolved[name]

    def made(self, term: Term) -> _TypedTerm:
        """Return the stream that the specification makes, resolved, and its fields."""
        resolved, fields = self.term(term)
        self._check_size(resolved, term.position)
        if fields is not None and len(fields) > MAX_FIELDS:
            message = f'the stream has {len(fields)} fields; at most {MAX_FIELDS} are possible'
            raise self._error(message, term.position)
        return resolved, fields

    def term(self, term: Term) -> _TypedTerm:
        """Return a term, resolved, and its fields."""
        return self.expiring(*self._term(term), term.position)

    def expiring(self, term: Term, fields: Fields | None, position: TextPosition) -> _TypedTerm:
        """Return a stream with its fields; these are floats if its values expire."""
        if _hides_nan(term) and any(map(self._sizes.expires, term.inputs)):
            message = f'{_title(term)} may hide that a value has expired; let its own values expire'
            raise self._error(message, position)
        if not term.constraints.expires:
            return term, fields
        if not isinstance(term, syntax.Select):
            message = (
                'only the values of a select expire; select the numbers, and write these '
                'constraints at its end'
            )
            raise self._error(message, position)
        for each in term.selections:
            found = None if fields is None else fields.get(each.name)
            if found not in {None, ValueType.INT, ValueType.FLOAT}:
                message = f"a value that expires is NaN, but '{each.field}' is "
                raise self._error(f'{message}{with_article(found)}; leave it out', position)
            if each.embedded_fields:
                message = f"'{each.renaming}' has the values of several objects, which expire "
                raise self._error(f'{message}one by one; select each object by itself', position)
        return term, dict.fromkeys((each.name for each in term.selections), ValueType.FLOAT)

    def _term(self, term: Term) -> _TypedTerm:
        match term:
            case syntax.StreamReference():
                return self._reference(term)
            case syntax.BuiltInSource():
                return self._built_in(term)
            case syntax.Select():
                return self._select(term)
            case syntax.Call():
                return self._call(term)
            case syntax.Merge():
                return self._merge(term)
            case syntax.Sync():
                return self._sync(term)

    def _reference(self, reference: syntax.StreamReference) -> _TypedTerm:
        target, fields = self._target(reference)
        if reference.constraints.is_empty:
            return target, fields
        try:
            constraints = target.constraints.merged(reference.constraints)
        except DyKnowError as error:
            message = f"stream '{reference.name}': {error.message}"
            raise self._error(message, reference.position) from None
        constrained = replace(target, constraints=constraints)
        if not reference.is_topic:
            self._add_name(reference.name, constrained, reference.position)
        return constrained, fields

    def _target(self, reference: syntax.StreamReference) -> _TypedTerm:
        name = reference.name
        if not reference.is_topic and name in self._streams:
            return self.stream(self._streams[name])
        if name in self._sources:
            return self._source(self._sources[name])
        if reference.is_topic:
            return syntax.StreamReference(name, is_topic=True), self._topic_fields(name)
        if name in self._existing:
            if name not in self._used:
                self._used.add(name)
                self._add_name(name, self._existing[name].term, reference.position)
            return self._existing[name].term, self._existing[name].fields
        known = _listing({*self._streams, *self._sources, *self._existing})
        raise self._error(
            f"there is no stream '{name}' (there are: {known}); a topic is written in quotes",
            reference.position,
            ExitCode.NOT_FOUND,
        )

    def _source(self, source: syntax.SourceDeclaration) -> _TypedTerm:
        known = self._topic_fields(source.name)
        for field in source.fields:
            found = self._field(known, field.name, f"topic '{source.name}'", field.position)
            if not fits(found, field.type):
                message = f"field '{field.name}' of topic '{source.name}' is {with_article(found)}"
                raise self._error(f'{message}, not {with_article(field.type)}', field.position)
        topic = syntax.StreamReference(source.name, is_topic=True)
        term = syntax.Select(tuple(syntax.Selection(field.name) for field in source.fields), topic)
        self._add_name(source.name, term, source.position)
        return term, {field.name: field.type for field in source.fields}

    def _built_in(self, source: syntax.BuiltInSource) -> _TypedTerm:
        for topic in syntax.references(source):
            if fault := type_fault(source, self._topic_fields(topic.name)):
                raise self._error(fault, source.position)
        return source, built_in_fields(source)

    def _select(self, select: syntax.Select) -> _TypedTerm:
        source, fields = self.term(select.source)
        owner = _title(select.source)
        if select.elements is not None:
            fields = self._element_fields(select, source, select.elements, fields)
        for condition in select.conditions:
            self._check_condition(condition, fields, owner)
        selected = self._selected(select.selections, fields, owner)
        return replace(select, source=source), selected

    def _check_condition(
        self, condition: syntax.Condition, fields: Fields | None, owner: str
    ) -> None:
        found = self._field(fields, condition.field, owner, condition.position)
        if found is not None and found not in comparable_types(condition):
            message = (
                f"field '{condition.field}' is {with_article(found)}, which cannot be compared "
                f'with {value_text(condition.value)}'
            )
            raise self._error(message, condition.position)

    def _element_fields(
        self, select: syntax.Select, source: Term, elements: ArrayElements, fields: Fields | None
    ) -> Fields | None:
        """Return the fields of the samples that are made of the elements of an array."""
        if not isinstance(source, syntax.StreamReference):
            message = f'{_title(select.source)} has no arrays; take the elements of a topic'
            raise self._error(message, select.source.position)
        if fields is None:
            return None
        found = element_fields(fields, elements)
        if isinstance(found, str):
            raise self._error(f'{_title(select.source)}: {found}', select.source.position)
        return found

    def _selected(
        self, selections: Iterable[syntax.Selection], fields: Fields | None, owner: str
    ) -> Fields | None:
        selected: dict[str, ValueType | None] = {}
        dynamic = False
        for each in selections:
            for embedded in each.embedded_fields:
                dynamic = True
                self._field(fields, embedded, owner, each.position)
            if each.name in selected:
                message = f"two selected fields are both named '{each.name}'; rename one"
                raise self._error(message, each.position)
            found = self._field(fields, each.field, owner, each.position)
            if each.unless is not None:
                self._check_condition(each.unless, fields, owner)
                if found not in {None, ValueType.INT, ValueType.FLOAT}:
                    message = f"'unless' makes a number NaN, but '{each.field}' is "
                    raise self._error(f'{message}{with_article(found)}', each.position)
                found = ValueType.FLOAT
            selected[each.name] = found
        return None if dynamic else selected

    def _call(self, call: syntax.Call) -> _TypedTerm:
        declaration = self._calls.get(call.unit)
        if declaration is None:
            known = _listing(self._calls)
            message = f"computational unit '{call.unit}' is not declared (declared are: {known})"
            raise self._error(message, call.position, ExitCode.NOT_FOUND)
        if len(call.inputs) != len(declaration.parameters):
            raise self._error(
                f"computational unit '{call.unit}' takes {_streams(len(declaration.parameters))}, "
                f'not {len(call.inputs)}',
                call.position,
            )
        inputs = []
        for each, parameter in zip(call.inputs, declaration.parameters, strict=True):
            source, fields = self.term(each)
            self._check_argument(each, fields, parameter, call.unit)
            inputs.append(source)
        self._check_settings(call)
        outputs = {each.name: each.type for each in declaration.outputs}
        return replace(call, inputs=tuple(inputs), declaration=declaration), outputs

    def _check_argument(
        self,
        argument: Term,
        fields: Fields | None,
        parameter: Sequence[syntax.TypedField],
        unit: str,
    ) -> None:
        for field in parameter:
            found = self._field(fields, field.name, _title(argument), argument.position)
            if not fits(found, field.type):
                message = (
                    f"field '{field.name}' of {_title(argument)} is {with_article(found)}, "
                    f"but computational unit '{unit}' takes {with_article(field.type)}"
                )
                raise self._error(message, argument.position)

    def _check_settings(self, call: syntax.Call) -> None:
        possible = settings(self._units[call.unit])
        seen: set[str] = set()
        for each in call.arguments:
            if possible is not None and each.name not in possible:
                message = f"computational unit '{call.unit}' has no parameter '{each.name}'"
                raise self._error(f'{message} (it has: {_listing(possible)})', each.position)
            if each.name in seen:
                raise self._error(f"parameter '{each.name}' is given twice", each.position)
            seen.add(each.name)
            if possible is not None and (fault := setting_fault(possible[each.name], each)):
                message = f"parameter '{each.name}' of computational unit '{call.unit}' {fault}"
                raise self._error(message, each.position)

    def _merge(self, merge: syntax.Merge) -> _TypedTerm:
        inputs, fields = zip(*map(self.term, merge.inputs), strict=True)
        same = all(each == fields[0] for each in fields)
        return replace(merge, inputs=inputs), fields[0] if same else None

    def _sync(self, sync: syntax.Sync) -> _TypedTerm:
        inputs, all_fields = zip(*map(self.term, sync.inputs), strict=True)
        owners: dict[str, Term] = {}
        for each, fields in zip(sync.inputs, all_fields, strict=True):
            for name in fields or ():
                first = owners.setdefault(name, each)
                if first is not each:
                    raise self._error(
                        collision_text(name, _title(first), _title(each)), each.position
                    )
        known = [fields for fields in all_fields if fields is not None]
        joined = {name: found for fields in known for name, found in fields.items()}
        if sync.approximation is syntax.Approximation.LINEAR:
            joined = {name: interpolated(found) for name, found in joined.items()}
        return replace(sync, inputs=inputs), joined if len(known) == len(all_fields) else None

    def _field(
        self, fields: Fields | None, name: str, owner: str, position: TextPosition
    ) -> ValueType | None:
        """Return the type of a field, or `None` if it is not known."""
        if fields is None:
            return None
        if listed_as(fields, name) is None:
            raise self._error(absence(owner, fields, name), position)
        return field_type(fields, name)

    def _check_declared_once(self, declarations: Iterable[syntax.Declaration]) -> None:
        streams: set[str] = set()
        units: set[str] = set()
        for each in declarations:
            if isinstance(each, syntax.SinkDeclaration):
                continue
            names = units if isinstance(each, syntax.UnitDeclaration) else streams
            if each.name in names:
                raise self._error(f"'{each.name}' is declared twice", each.position)
            names.add(each.name)
            if names is units and each.name not in self._units:
                known = _listing(self._units)
                message = f"there is no computational unit '{each.name}' (there are: {known})"
                raise self._error(message, each.position, ExitCode.NOT_FOUND)

    def _check_size(self, term: Term, position: TextPosition) -> None:
        if excess := self._sizes.excess(term):
            raise self._error(f'the stream is too large: {excess}', position)

    def _add_name(self, name: str, term: Term, position: TextPosition) -> None:
        self._check_size(term, position)
        # The operators below the constraints have the same name.
        for text in (str(term), str(replace(term, constraints=NO_CONSTRAINTS))):
            self.names.setdefault(text, name)


def _hides_nan(term: Term) -> bool:
    """Return True if NaN in an input may give no sample, or one with other values."""
    is_filter = isinstance(term, syntax.Select) and bool(term.conditions)
    return is_filter or (isinstance(term, syntax.Call) and term.unit != 'convert')


def _title(term: Term) -> str:
    return f"stream '{shortened(term.name if isinstance(term, syntax.StreamReference) else term)}'"


def _streams(count: int) -> str:
    return f'{count} stream{"s" * (count != 1)}'


def _listing(names: Iterable[str]) -> str:
    return ', '.join(sorted(names)) or 'none'
