"""Computational units: user code that runs on streams (paper, section III).

A unit is registered in the entry point group `dyknow.computational_units` of any installed package,
and declared in the specification that uses it:

    compunit power: float electrical_power((voltage: float, current: float));

It is a function, or a class; each use of a class creates an instance, which is then called.
Arguments that a use passes by name, `mean(power, window = 5 s)`, go to the constructor, or to the
keyword-only parameters of the function; a duration is in nanoseconds.

A unit is called with one mapping for each of its streams: the fields in the order of the
declaration, each with its value. If it has a parameter `valid_time`, it receives the valid time of
the sample in nanoseconds by that name. It returns the value of the declared field, or a mapping of
several fields to their values; `None` emits no sample. It should return quickly, because it blocks
the whole dataflow. A unit without memory may have a method `many` that gets the valid times and the
columns of its fields, and returns columns of results, as floats: so recordings run by columns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import entry_points
from inspect import isclass, signature
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import Alternatives, Value, ValueType, choices, format_duration, listed
from dyknow_space import MovingDistance, RegionDistances, SightDistance, SweptDistances
from dyknow_stream_processing.dataflow import built_in_units as units
from dyknow_stream_processing.dataflow import forecasts
from dyknow_stream_processing.dataflow.batches import (
    Columns,
    Planned,
    Refusal,
    SampleBatch,
    Times,
    column_of,
    refuse,
    rows_of,
)
from dyknow_stream_processing.dataflow.operators import Operator, Wiring
from dyknow_stream_processing.dataflow.synchronisation import SynchronisedOperator, Values
from dyknow_stream_processing.errors import StreamError, open_value
from dyknow_stream_processing.language.specification import UnitArgument, UnitDeclaration
from dyknow_stream_processing.language.type_rules import TIME, Unit
from dyknow_stream_processing.sample import missing_text
from dyknow_stream_processing.violation import Fault, ViolationKind

ENTRY_POINTS: Final = 'dyknow.computational_units'
"""The entry point group that units are registered in."""

_BUILT_IN: Final[Mapping[str, Unit]] = {
    'constant_turn_rate': forecasts.ConstantTurnRate,
    'constant_velocity': forecasts.ConstantVelocity,
    'convert': units.Convert,
    'distance': units.distance,
    'electrical_power': units.electrical_power,
    'kalman': forecasts.Kalman,
    'magnitude': units.magnitude,
    'maximum': units.Maximum,
    'mean': units.Mean,
    'minimum': units.Minimum,
    'moving_distance': MovingDistance,
    'planar_pose': units.planar_pose,
    'planned_path': forecasts.PlannedPath,
    'rate_of_change': units.RateOfChange,
    'region_distances': RegionDistances,
    'sight_distance': SightDistance,
    'speed': units.Speed,
    'swept_distances': SweptDistances,
}

STATELESS_UNITS: Final[frozenset[Unit]] = frozenset(
    {
        forecasts.ConstantTurnRate,
        forecasts.ConstantVelocity,
        RegionDistances,
        units.Convert,
        units.electrical_power,
        units.magnitude,
        units.planar_pose,
    }
)
"""Units whose result depends on one sample alone, so it does not matter how often they compute."""

_PYTHON_TYPES: Final[Mapping[ValueType, type[Value]]] = {
    ValueType.BOOLEAN: bool,
    ValueType.INT: int,
    ValueType.FLOAT: float,
    ValueType.STRING: str,
}


@cache  # To read what all installed packages register takes tens of milliseconds.
def load_units() -> Mapping[str, Unit]:
    """Load all computational units once: built-in ones, and the ones of packages.

    Raises:
        StreamError: if a registered unit cannot be loaded.
    """
    registered = dict(_BUILT_IN)
    for entry_point in entry_points(group=ENTRY_POINTS):
        try:
            registered[entry_point.name] = entry_point.load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # A module may raise any while it is imported.
            raise StreamError(
                f"computational unit '{entry_point.name}' ({entry_point.value}) cannot be loaded: "
                f'{_description(error)}'
            ) from error
    return registered


class UnitCall:
    """One use of a computational unit, as a function of the samples of its inputs.

    Raises:
        StreamError: if the unit is a class that cannot be instantiated.
    """

    def __init__(
        self, unit: Unit, declaration: UnitDeclaration, arguments: Sequence[UnitArgument]
    ) -> None:
        named = {each.name: each.value for each in arguments}
        self.parameters = [
            tuple(field.name for field in fields) for fields in declaration.parameters
        ]
        """The fields of each input."""
        self._call: Unit = _instance(unit, declaration.name, named)
        self._is_monotone = unit is units.Convert
        self.takes_time = _takes_time(self._call)
        """True if it gets the valid time."""
        self.outputs = {each.name: each.type for each in declaration.outputs}
        """The types of the fields of its results."""
        self._check_inputs(declaration.name)
        self._plain_types = {_PYTHON_TYPES[each] for each in self.outputs.values()}

    def __call__(
        self, valid_time: int, inputs: Sequence[Mapping[str, Value]]
    ) -> Mapping[str, Value] | None:
        """Return the result, if there is one; user code may raise any exception."""
        timing = {TIME: valid_time} if self.takes_time else {}
        value = self._call(*inputs, **timing)
        if value is None:
            return None
        found = value if isinstance(value, Mapping) else dict.fromkeys(self.outputs, value)
        if found.keys() != self.outputs.keys() or (found is not value and len(found) > 1):
            raise TypeError(f'returned {value!r}, not a value for each of {listed(self.outputs)}')
        if len(self._plain_types) == 1 and self._plain_types == {*map(type, found.values())}:
            return dict(found)
        return {name: _typed(each, self.outputs[name]) for name, each in found.items()}

    def _check_inputs(self, name: str) -> None:
        """Raise an error if the unit does not take the declared number of streams."""
        timing = {TIME: 0} if self.takes_time else {}
        with suppress(ValueError):  # Some functions written in C have no signature.
            # A decorator may change the arguments before it passes them on.
            found = signature(self._call, follow_wrapped=False)
            try:
                found.bind(*self.parameters, **timing)
            except TypeError as error:
                count = len(self.parameters)
                streams = 'one stream' if count == 1 else f'{count} streams'
                raise StreamError(
                    f"computational unit '{name}' does not take {streams}: {error}"
                ) from None

    @property
    def window(self) -> int:
        """The length of its window, in nanoseconds; 0 without one."""
        return self._call.window if isinstance(self._call, units.SlidingWindow) else 0

    @property
    def warning(self) -> str:
        """The drift of a forecast; empty for none, and for other units."""
        drift = self._call.drift if isinstance(self._call, forecasts.Forecast) else None
        return drift.warning if drift else ''

    def of_alternatives(
        self, valid_time: int, inputs: Sequence[Mapping[str, Value]]
    ) -> Mapping[str, Value] | None:
        """Return the results for all choices among values that have alternatives.

        User code may raise any exception.
        """
        fields = {
            (port, name): each for port, one in enumerate(inputs) for name, each in one.items()
        }
        given = [each for each in fields.values() if isinstance(each, Alternatives)]
        reason, is_interval = given[0].reason, any(each.is_interval for each in given)
        found = [
            self(
                valid_time,
                [{name: chosen[port, name] for name in one} for port, one in enumerate(inputs)],
            )
            for chosen in choices(fields, ends=self._is_monotone)
        ]
        results = [each for each in found if each is not None]
        if not results:
            return None
        if len(results) < len(found):
            raise ValueError(f'it has results for some of {len(found)} values alone, as {reason}')
        return {
            name: Alternatives.of([each[name] for each in results], reason, is_interval=is_interval)
            for name in self.outputs
        }

    def many(self, times: Times, columns: Columns) -> tuple[NDArray[np.bool_], Columns]:
        """Return which samples have a result, and the columns of the results.

        User code may raise any exception.
        """
        many = getattr(self._call, 'many', None) if len(times) else None
        if many is not None and {*self.outputs.values()} == {ValueType.FLOAT}:
            found: Columns = many(times, columns)
            if found.keys() == self.outputs.keys():
                return np.ones(len(times), np.bool_), found
        results = [self(time, [fields]) for time, fields in rows_of(times, columns)]
        given = [each for each in results if each is not None]
        return np.array([each is not None for each in results], np.bool_), {
            name: column_of([each[name] for each in given]) for name in self.outputs
        }


class UnitOperator(SynchronisedOperator):
    """One use of a computational unit: one sample for each tick of its inputs.

    Raises:
        StreamError: if the unit is a class that cannot be instantiated.
    """

    def __init__(
        self,
        wiring: Wiring,
        unit: Unit,
        declaration: UnitDeclaration,
        arguments: Sequence[UnitArgument],
    ) -> None:
        super().__init__(wiring)
        self._name = declaration.name
        self.call = UnitCall(unit, declaration, arguments)
        self._is_stateless = unit in STATELESS_UNITS
        has_memory = isclass(unit) and not self._is_stateless
        self._keeps_alternatives = not (self.call.takes_time or has_memory)
        self._open: StreamError | None = None
        """Why it computes nothing any more: the times of samples in its memory are open."""
        self._first: int | None = None
        """The valid time of its first sample."""
        self._is_recreated = False

    def complete_window(self) -> None:
        """Emit no result of a window that may lack samples from before the first one here."""
        self._is_recreated = True

    def obstacle(self, name: Callable[[Operator], str]) -> str:
        """Return why it has no results; a window may not be complete yet."""
        if self._is_recreated and self.call.window and self.emitted_at is None:
            window = format_duration(self.call.window)
            return f'{name(self)} was recreated: its window of {window} has not passed yet'
        return super().obstacle(name)

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Compute at once if there is only one input; otherwise synchronise."""
        if len(self.inputs) == 1:
            self._compute(valid_time, [fields], watermark, now)
            self._promise(watermark, now)
        else:
            super().receive(port, valid_time, fields, watermark, now)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Promise the same if there is only one input; otherwise synchronise."""
        if len(self.inputs) == 1:
            self._promise(watermark, now)
        else:
            super().promise(port, watermark, now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan to compute without a memory, from one input: a refused plan computes twice."""
        if len(inputs) > 1 or not self._is_stateless:
            refuse(Refusal.OPERATOR)
        (batch,), (names,) = inputs, self.call.parameters
        if len(batch) and not set(names) <= batch.columns.keys():
            refuse(Refusal.FIELDS)
        columns = {name: batch.columns[name] for name in names} if len(batch) else {}
        try:
            is_result, found = self.call.many(batch.valid_times, columns)
        except KeyboardInterrupt:
            raise
        # User code may raise any exception; steps report it.
        except BaseException:  # noqa: BLE001
            refuse(Refusal.VALUE)
        output = replace(replace(batch, columns={}).rows(is_result), columns=found)
        return Planned(output, self.inputs[0].watermark)

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        self._compute(valid_time, values, valid_time, now)

    def _compute(self, valid_time: int, values: Values, watermark: int, now: int) -> None:
        if self._first is None:
            self._first = valid_time
        try:
            arguments = [
                {name: fields[name] for name in names}
                for names, fields in zip(self.call.parameters, values, strict=True)
            ]
        except KeyError as error:
            message = f"computational unit '{self._name}' finds {missing_text(error)}"
            self._reject(Fault(ViolationKind.FIELDS, valid_time, message))
            return
        given = next((each for each in arguments if Alternatives.are_among(each.values())), None)
        if given is not None and not self._keeps_alternatives and not self._open:
            use = f"given to the computational unit '{self._name}', which depends on its time"
            self._open = open_value(given, use)
        if self._open:
            self._reject(Fault(ViolationKind.COMPUTATIONAL_UNIT, valid_time, self._open.message))
            return
        try:
            compute = self.call if given is None else self.call.of_alternatives
            result = compute(valid_time, arguments)
        except KeyboardInterrupt:
            raise
        # User code may raise any exception, also SystemExit; it is contained and reported.
        except BaseException as error:  # noqa: BLE001
            message = f"computational unit '{self._name}': {_description(error)}"
            self._reject(Fault(ViolationKind.COMPUTATIONAL_UNIT, valid_time, message))
        else:
            is_partial = self._is_recreated and valid_time - self._first < self.call.window
            if result is not None and not is_partial:
                self._emit(valid_time, result, watermark, now)


def _instance(unit: Unit, name: str, arguments: Mapping[str, Value]) -> Any:
    if not isclass(unit):
        return partial(unit, **arguments) if arguments else unit
    try:
        return unit(**arguments)
    except KeyboardInterrupt:
        raise
    # The constructor is user code, too.
    except BaseException as error:
        raise StreamError(
            f"computational unit '{name}' cannot be made: {_description(error)}"
        ) from error


def _description(error: BaseException) -> str:
    return f'{type(error).__name__}: {error}'.removesuffix(': ')


def _takes_time(call: Unit) -> bool:
    try:
        return TIME in signature(call).parameters
    except ValueError:  # Some functions written in C have no signature.
        return False


def _typed(value: object, expected: ValueType) -> Value:
    """Convert a value to the plain declared type; subclasses, such as numpy's float64, fit."""
    plain = _PYTHON_TYPES[expected]
    accepted = (int, float) if plain is float else plain
    if isinstance(value, accepted) and isinstance(value, bool) == (plain is bool):
        return plain(value)
    raise TypeError(f'returned {value!r} ({type(value).__name__}), which is no {expected}')
