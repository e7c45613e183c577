"""Recordings of verdicts: what rosbags reads of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_bags import STORE, header, write_messages

from dyknow_common import SECOND_NS, Verdict
from dyknow_coordinator import Grounding, SymbolGrounding, verdict_token
from dyknow_recordings import (
    Episode,
    FormulaReport,
    RecordingError,
    RecordingReport,
    StateGap,
    open_recording,
)
from dyknow_recordings.check import main
from dyknow_recordings.evaluation.recorded_map import RecordedMap
from dyknow_recordings.reporting import verdict_messages
from dyknow_recordings.reporting.verdict_recording import (
    DIAGNOSTICS,
    MARKERS,
    RESULTS,
    VERDICTS,
    VIOLATIONS,
    VerdictRecordings,
    write_verdicts,
)
from dyknow_space import Region, geometry_of
from dyknow_stream_processing import Violation

START = 1_700_000_000 * SECOND_NS
END = START + 10 * SECOND_NS
OK, WARN, ERROR = range(3)


def at(seconds: float) -> int:
    return START + round(seconds * 1000) * 1_000_000


def report(*formulas: FormulaReport, recording: str = 'nowhere') -> RecordingReport:
    return RecordingReport(recording, START, END, formulas)


UNDECIDED = Episode(at(0), residual_formula='always (p)')
FALSE = Episode(at(0), Verdict.FALSE, at(4), 'p = 1 is not > 2')
TRUE = Episode(at(5), Verdict.TRUE, at(6), 'p = 3')
SILENT = Violation('a', 'max_delay', at(2), at(3), 2 * SECOND_NS, SECOND_NS, 'a is late')


class Found(NamedTuple):
    seconds: float
    """After the start of the recording."""
    topic: str
    message: Any


def written(path: Path) -> list[Found]:
    """The messages of a recording, read by rosbags with its own definitions only."""
    types = get_typestore(Stores.EMPTY)
    with Reader(path) as reader:
        for each in reader.connections:
            types.register(get_types_from_msg(each.msgdef.data, each.msgtype))
        return [
            Found((time - START) / SECOND_NS, each.topic, types.deserialize_cdr(data, each.msgtype))
            for each, time, data in reader.messages()
        ]


def written_of(found: RecordingReport, folder: Path, topic: str) -> list[Found]:
    path = folder / 'out.mcap'
    write_verdicts(found, path)
    return [each for each in written(path) if each.topic == topic]


def test_results_have_verdict_and_error(tmp_path: Path) -> None:
    failed = Episode(at(0), error=RecordingError('a broke its constraints'))
    found = written_of(
        report(
            FormulaReport('two', 'p', (FALSE, TRUE), states=3),
            FormulaReport('failed', 'q', (failed,), states=3, violations=(SILENT,)),
            FormulaReport('open', 'r', (UNDECIDED,), states=3),
            FormulaReport('wrong', 'r (', (), RecordingError('syntax error')),
        ),
        tmp_path,
        RESULTS,
    )
    assert [
        (each.seconds, each.message.formula_name, each.message.formula_id, each.message.verdict)
        for each in found
    ] == [(0, 'wrong', 0, 0), (3, 'failed', 0, 0), (4, 'two', 0, 2), (6, 'two', 1, 1)]
    assert [each.message.exit_status.code for each in found] == [1, 1, 0, 0]
    assert found[0].message.exit_status.message == 'syntax error'
    decided = found[2].message
    assert decided.explanation == 'p = 1 is not > 2'
    assert (decided.decided_at.sec, decided.decided_at.nanosec) == (1_700_000_004, 0)
    assert decided.header.stamp.sec == 1_700_000_004


def test_numbers_are_steps(tmp_path: Path) -> None:
    found = written_of(
        report(FormulaReport('two', 'p', (FALSE, TRUE), states=3)), tmp_path, f'{VERDICTS}/two'
    )
    numbers = [(round(each.seconds, 3), each.message.data) for each in found]
    assert numbers[:4] == [(0, 0), (1, 0), (2, 0), (3, 0)]
    assert numbers[4:6] == [(4, 0), (4, -1)]
    assert found[4].seconds < 4
    assert numbers[7:9] == [(6, -1), (6, 1)]
    assert numbers[-1] == (10, 1)


def test_an_error_is_another_number(tmp_path: Path) -> None:
    wrong = FormulaReport('wrong', 'r (', (), RecordingError('syntax error'))
    found = written_of(report(wrong), tmp_path, f'{VERDICTS}/wrong')
    assert {each.message.data for each in found if each.seconds > 0} == {-2}


def levels(found: Sequence[Found]) -> list[tuple[float, int, str]]:
    """The changes of the only diagnosis."""
    changes: list[tuple[float, int, str]] = []
    for seconds, _, message in found:
        (status,) = message.status
        if not changes or changes[-1][1:] != (status.level, status.message):
            changes.append((seconds, status.level, status.message))
    return changes


def test_diagnostics_follow_gaps_and_verdicts(tmp_path: Path) -> None:
    formula = FormulaReport(
        'p', 'p', (FALSE,), states=3, violations=(SILENT,), gaps=(StateGap(at(1.5), at(3.5)),)
    )
    found = written_of(report(formula), tmp_path, DIAGNOSTICS)
    assert levels(found) == [
        (0, OK, 'undecided'),
        (1.5, WARN, 'interrupted: a is late'),
        (3.5, OK, 'undecided'),
        (4, ERROR, 'false: p = 1 is not > 2'),
    ]
    assert {0.0, 1.0, 2.0, 9.0, 10.0} <= {each.seconds for each in found}
    (status,) = found[-1].message.status
    assert status.name == 'dyknow check: p'
    assert {each.key: each.value for each in status.values}['verdict'] == 'false'


def test_the_end_of_a_recording_is_diagnosed(tmp_path: Path) -> None:
    broken = replace(UNDECIDED, presumably_false=True)
    obligation = FormulaReport('p', 'p', (broken,), states=3)
    *_, last = levels(written_of(report(obligation), tmp_path, DIAGNOSTICS))
    assert last == (10, WARN, 'presumably false: only a later state can make it true')
    waiting = FormulaReport('p', 'p', waits_for='/a is silent')
    *_, last = levels(written_of(report(waiting), tmp_path, DIAGNOSTICS))
    assert last == (10, WARN, 'waiting for states: /a is silent')


def test_a_violation_of_several_formulas_is_written_once(tmp_path: Path) -> None:
    formulas = [FormulaReport(name, name, (TRUE,), violations=(SILENT,)) for name in 'ab']
    (found,) = written_of(report(*formulas), tmp_path, VIOLATIONS)
    assert found.seconds == 3
    assert found.message.message == 'a is late'
    assert found.message.observed.sec == 2


def test_stamps_of_another_clock(tmp_path: Path) -> None:
    """Simulated time starts at 5 s: the verdict 2 s later is 2 s after the start."""
    episode = Episode(5 * SECOND_NS, Verdict.TRUE, 7 * SECOND_NS)
    formula = FormulaReport('p', 'p', (episode,), states=3)
    (found,) = written_of(report(formula), tmp_path, RESULTS)
    assert found.seconds == 2
    assert found.message.decided_at.sec == 7


def test_stamps_from_before_the_start(tmp_path: Path) -> None:
    """Messages may come seconds after their stamps, by the same clock."""
    formula = FormulaReport('p', 'p', (Episode(at(-5), Verdict.TRUE, at(1)),), states=3)
    (found,) = written_of(report(formula), tmp_path, RESULTS)
    assert found.seconds == 1


def test_a_long_recording_has_fewer_reports(tmp_path: Path) -> None:
    century = replace(report(FormulaReport('p', 'p', (TRUE,))), end_time=START * 2)
    assert 10_000 <= len(written_of(century, tmp_path, DIAGNOSTICS)) < 10_010


def test_many_episodes_have_no_diagnosis_each(tmp_path: Path) -> None:
    """As with `--every state`: the verdict changes in the middle."""
    episodes = tuple(
        Episode(at(n / 2000), Verdict.TRUE if n < 10_000 else Verdict.FALSE, at(n / 2000))
        for n in range(20_000)
    )
    formula = FormulaReport('p', 'p', episodes, states=20_000)
    write_verdicts(report(formula), tmp_path / 'o.mcap')
    counts = Counter(each.topic for each in written(tmp_path / 'o.mcap'))
    assert counts == {RESULTS: 20_000, DIAGNOSTICS: 11, f'{VERDICTS}/p': 11 + 1}


def test_a_trace_that_begins_before_zero(tmp_path: Path) -> None:
    episode = Episode(-5 * SECOND_NS, Verdict.TRUE, -3 * SECOND_NS)
    formula = FormulaReport('p', 'p', (episode,), states=3)
    trace = replace(report(formula), start_time=-5 * SECOND_NS, end_time=-1 * SECOND_NS)
    write_verdicts(trace, tmp_path / 'o.mcap')
    with open_recording(tmp_path / 'o.mcap') as found:
        assert (found.start_time, found.end_time) == (0, 4 * SECOND_NS)


def test_topics_of_names(tmp_path: Path) -> None:
    names = ('a', 'a', 'always ("/uav".x > 2)', '2 < 3', '◊', 'x' * 300)
    write_verdicts(report(*(FormulaReport(name, name) for name in names)), tmp_path / 'o.mcap')
    with open_recording(tmp_path / 'o.mcap') as found:
        topics = {each.name for each in found.topics}
    tokens = ['a', 'a_2', *map(verdict_token, names[2:])]
    assert topics == {DIAGNOSTICS, *(f'{VERDICTS}/{token}' for token in tokens)}
    assert len(topics) == 1 + len(names)


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """Three vehicles, ten times a second; the third is in another frame."""
    path = tmp_path / 'flight'
    types: Any = STORE.types
    point, quaternion, vector, pose, posed, twist, twisted = (
        types[f'geometry_msgs/msg/{name}']
        for name in (
            *('Point', 'Quaternion', 'Vector3', 'Pose', 'PoseWithCovariance'),
            *('Twist', 'TwistWithCovariance'),
        )
    )
    zeros, found = np.zeros(36), []
    still = twisted(twist(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)), zeros)
    for step, n in product(range(101), range(3)):
        time = at(step / 10)
        here = pose(point(float(n), 0.0, step / 10), quaternion(0.0, 0.0, 0.0, 1.0))
        stamped = header(time, 'other' if n == 2 else 'map')
        message = types['nav_msgs/msg/Odometry'](stamped, '', posed(here, zeros), still)
        found.append((time, f'/fleet/uav{n}/odometry', message))
    write_messages(path, found)
    return path


CEILING = 'forall u in UAV: (always (Altitude[u] < 4))'


def test_markers_move_with_the_vehicles(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    groundings = tuple(
        SymbolGrounding(f'Altitude[uav{n}]', Grounding.SEMANTIC, 's') for n in range(3)
    )
    formula = FormulaReport('ceiling', CEILING, (FALSE,), states=9, groundings=groundings)
    found = written_of(report(formula, recording=str(flight)), tmp_path, MARKERS)
    assert len(found) == 51
    label_before, label_after = (
        next(marker for marker in each.message.markers if marker.type == 9)
        for each in (found[0], found[-1])
    )
    assert label_before.header.frame_id == 'map'
    assert label_before.text == f'ceiling: undecided\n{CEILING}'
    assert label_after.text.startswith('ceiling: false: p = 1 is not > 2')
    assert label_after.pose.position.z - label_before.pose.position.z == pytest.approx(10, abs=2)
    assert (label_before.color.g, label_after.color.r) == pytest.approx((0.8, 1.0))
    assert 'uav2 is not shown by markers: its positions are not in the frame' in (
        capsys.readouterr().err
    )


def test_markers_show_the_regions_of_the_frame(flight: Path, tmp_path: Path) -> None:
    corners = geometry_of('POLYGON ((0 0, 4 0, 4 3, 0 0))')
    zones = tuple(Region(name, (), name, corners) for name in ('map', 'odom'))
    groundings = tuple(
        SymbolGrounding(f'distance[uav1, {each.name}]', Grounding.SEMANTIC, 's') for each in zones
    )
    formula = FormulaReport('out', 'always true', (FALSE,), states=9, groundings=groundings)
    drawn = replace(report(formula, recording=str(flight)), map=RecordedMap('map', zones))
    lines = [
        marker
        for marker in written_of(drawn, tmp_path, MARKERS)[-1].message.markers
        if marker.type == 5
    ]
    assert [len(each.points) for each in lines] == [6]


def test_the_command_writes_a_file(flight: Path, tmp_path: Path) -> None:
    formula = 'always "/fleet/uav1/odometry".pose.pose.position.z < 4'
    out = tmp_path / 'verdicts.mcap'
    out.write_text('of an earlier run')
    assert main([str(flight), '--formula', formula, '--verdicts', str(out)]) == 1
    (result,) = (each for each in written(out) if each.topic == RESULTS)
    assert (result.seconds, result.message.verdict) == (4, 2)
    assert main([str(out), '--topics']) == 0
    assert {each.name for each in tmp_path.iterdir()} == {'flight', 'verdicts.mcap'}


def test_several_recordings_need_a_folder(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / 'again' / 'flight'
    again.parent.mkdir()
    again.symlink_to(flight)
    arguments = [str(flight), str(flight), '--formula', '1 < 2', '--verdicts']
    assert main([*arguments, str(tmp_path / 'out.mcap')]) == 2
    assert 'the verdicts of 2 recordings need a folder' in capsys.readouterr().err
    assert main([*arguments, str(tmp_path / 'new' / 'out')]) == 0
    written_files = sorted(each.name for each in (tmp_path / 'new' / 'out').iterdir())
    assert written_files == ['flight.mcap', 'flight_2.mcap']


def test_a_target_that_cannot_be_written(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'file').touch()
    target = tmp_path / 'file' / 'out.mcap'
    assert main([str(flight), '--formula', '1 < 2', '--verdicts', str(target)]) == 2
    reason = f'{tmp_path / "file"} is a file; give FILE.mcap, or a folder for its recordings'
    assert f'cannot write to {target}: {reason}' in capsys.readouterr().err
    with pytest.raises(RecordingError, match=f'cannot write to {tmp_path / "file"}: {reason}'):
        VerdictRecordings(tmp_path / 'file', 1)
    (tmp_path / 'is_a_folder.mcap').mkdir()
    with pytest.raises(RecordingError, match=r'cannot write .*is_a_folder.mcap: '):
        VerdictRecordings(tmp_path / 'is_a_folder.mcap', 1).add(report())


@pytest.fixture
def _forgotten_types() -> Any:
    verdict_messages.message_types.cache_clear()
    yield
    verdict_messages.message_types.cache_clear()


@pytest.mark.usefixtures('_forgotten_types')
def test_definitions_that_are_installed_or_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = Path(verdict_messages.__file__).resolve().parents[3] / 'dyknow_interfaces' / 'msg'
    moved = tmp_path / 'a' / 'b' / 'c' / 'd' / 'e' / 'verdict_messages.py'
    monkeypatch.setattr(verdict_messages, '__file__', str(moved))
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')
    with pytest.raises(RecordingError, match=r'ConstraintViolation.msg of .* is not installed'):
        verdict_messages.message_types()
    share = tmp_path / 'prefix' / 'share' / 'dyknow_interfaces'
    share.mkdir(parents=True)
    (share / 'msg').symlink_to(sources)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path / "prefix"}')
    assert verdict_messages.RESULT in verdict_messages.message_types().types
