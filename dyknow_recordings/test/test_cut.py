"""Parts of recordings that are cut out around failures show these failures, and no others."""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from small_bags import START, STORE, channel, chunk, header, mcap, schema, stored
from small_logs import log

from dyknow_configuration import RequestedFormula
from dyknow_recordings import Bag, MonitoringFiles, Outcome, RecordingError, offered_profile
from dyknow_recordings.cut import add_cut_options
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.jobs import RecordingJob

pytestmark = pytest.mark.long

MS, S = 1_000_000, 1_000_000_000

STAMPED, FLOAT = 'geometry_msgs/msg/PointStamped', 'std_msgs/msg/Float64'

FORMULAS = {
    'present': ('always ("/a".point.x < 4 or "/b".data < 3)', False),
    'response': ('always ("/b".data > 3 -> eventually[0 s, 2 s] "/c".data > 2)', False),
    'unbounded': ('always ("/b".data > 2 -> ("/b".data > 1 until "/c".data > 2))', False),
    'first': ('eventually[0 s, 20 s] "/c".data > 3', False),
    'past': ('always ("/b".data > 3 -> once[0 s, 3 s] "/a".point.x > 2)', False),
    'standing': ('"/b".data > 3 -> eventually[0 s, 2 s] "/a".point.x > 3', True),
    'standing past': ('"/b".data > 3 -> once[0 s, 2 s] "/c".data > 2', True),
}
REQUESTED = tuple(
    RequestedFormula(text, name, every_state=standing)
    for name, (text, standing) in FORMULAS.items()
)

# Of each message: the time since the one before in ms, how long before it was stamped or sent, and
# the value. /c is a topic with long silences.
SHORT = st.lists(
    st.tuples(st.integers(100, 900), st.integers(0, 60), st.integers(0, 4)), min_size=8, max_size=40
)
LONG = st.lists(
    st.tuples(st.sampled_from((50, 1_000, 9_000, 90_000)), st.integers(0, 60), st.integers(0, 4)),
    min_size=1,
    max_size=6,
)

QUIET = [(100, 0, 0)] * 8

Drawn = list[tuple[int, int, int]]


def float_message(value: float) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[FLOAT](float(value)), FLOAT))


def stamped_message(stamp: int, value: float) -> bytes:
    point = STORE.types['geometry_msgs/msg/Point'](float(value), 0.0, 0.0)
    message = STORE.types[STAMPED](header(stamp, ''), point)
    return bytes(STORE.serialize_cdr(message, STAMPED))


def write_bag(path: Path, drawn: tuple[Drawn, Drawn, Drawn]) -> None:
    """Write a bag with the topics /a (stamped), /b and /c (with times of sending)."""
    found: list[tuple[int, bytes]] = []
    for key, each in enumerate(drawn, start=1):
        time = START
        for distance, delay, value in each:
            time += distance * MS
            valid = time - delay * MS
            data = stamped_message(valid, value) if key == 1 else float_message(value)
            found.append((time, stored(key, time, data, sent=valid)))
    found.sort(key=lambda each: each[0])
    definitions = b''.join(
        schema(key, kind, STORE.generate_msgdef(kind, ros_version=2)[0]) + channel(key, key, topic)
        for key, (topic, kind) in enumerate(
            {'/a': STAMPED, '/b': FLOAT, '/c': FLOAT}.items(), start=1
        )
    )
    span = found[0][0], found[-1][0]
    path.write_bytes(mcap(definitions, chunk([each for _, each in found], span)))


def run_cut(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    add_cut_options(parser)
    options = parser.parse_args(list(map(str, arguments)))
    return int(options.command(options))


def checked(path: Path, formulas: tuple[RequestedFormula, ...] = REQUESTED) -> RecordingReport:
    report = RecordingJob(str(path), path, formulas, MonitoringFiles()).run()
    assert isinstance(report, RecordingReport)
    return report


def false_episodes(report: RecordingReport) -> set[tuple[str, int | None, int | None]]:
    """The false episodes: of formulas that are asked once, without their begins."""
    return {
        (formula.name, each.begin if FORMULAS[formula.name][1] else None, each.decided_at)
        for formula in report.formulas
        for each in formula.episodes
        if each.outcome is Outcome.FALSE
    }


def formulas_file(folder: Path) -> Path:
    path = folder / 'formulas.yaml'
    path.write_text(
        ''.join(
            f"- {{name: {name}, formula: '{text}', every_state: {str(standing).lower()}}}\n"
            for name, (text, standing) in FORMULAS.items()
        )
    )
    return path


@example(QUIET, QUIET, [(1000, 0, 4)], '0', '0')
@example(QUIET, [*QUIET[:5], (100, 0, 3), *QUIET[6:]], [(50, 0, 4), (50, 0, 0)], '0', '0')
@given(SHORT, SHORT, LONG, st.sampled_from(('0', '0.5', '20')), st.sampled_from(('0', '1')))
def test_parts_show_the_same_failures(
    a: Drawn, b: Drawn, c: Drawn, before: str, after: str
) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / 'flight.mcap'
        write_bag(path, (a, b, c))
        whole = checked(path)
        options = ('--before', before, '--after', after, '-o', folder / 'parts')
        code = run_cut(path, '--formulas', formulas_file(folder), *options)
        expected = false_episodes(whole)
        if not (folder / 'parts').exists():
            # 2: formulas may have had no state, which is an error without a time.
            assert not expected
            assert code in {1, 2}
            return
        assert code == 0
        parts = sorted((folder / 'parts').iterdir())
        found = {each for part in parts for each in false_episodes(checked(part))}
        assert expected <= found
        # Later violations of a formula that is asked once are not in the report of the whole.
        others = {each for each in found if FORMULAS[each[0]][1]}
        assert others <= expected
        once = {each[0] for each in found - expected}
        assert once <= {each[0] for each in expected}


def latched_bag(path: Path) -> None:
    """/a each 100 ms; /mode, latched, once at 1 s; /tf_static, latched, of two publishers."""
    latched = offered_profile(reliable=True, latched=True, depth=1)
    volatile = offered_profile(reliable=False, latched=False, depth=5)
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {
            '/a': (FLOAT, [volatile]),
            '/mode': (FLOAT, [latched]),
            '/tf_static': ('tf2_msgs/msg/TFMessage', [latched, latched]),
        }
        connections = {
            name: writer.add_connection(name, kind, typestore=STORE, offered_qos_profiles=offers)
            for name, (kind, offers) in topics.items()
        }
        frames = STORE.serialize_cdr(
            STORE.types['tf2_msgs/msg/TFMessage']([]), 'tf2_msgs/msg/TFMessage'
        )
        for number in range(2000):
            time = START + number * 100 * MS
            if number == 10:
                writer.write(connections['/mode'], time, float_message(7))
            if number in {3, 4}:
                writer.write(connections['/tf_static'], time, frames)
            value = 9 if number == 1500 else 1
            writer.write(connections['/a'], time, float_message(value))


def test_latched_messages_come_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, formula = tmp_path / 'flight', 'always ("/mode".data = 7 -> "/a".data < 9)'
    latched_bag(path)
    options = ('--formula', formula, '--before', '2', '--after', '1', '-o', tmp_path / 'parts')
    assert run_cut(path, *options) == 0
    (part,) = (tmp_path / 'parts').iterdir()
    with Bag(part) as bag:
        found = [(each.log_time - START, each.topic) for each in bag.messages()]
        qualities = {each.name: each.quality_of_service for each in bag.topics}
        assert bag.contents['/mode'].is_kept
        assert not bag.contents['/a'].is_kept
        begin = bag.start_time - START
    with Bag(path) as bag:
        assert qualities == {each.name: each.quality_of_service for each in bag.topics}
    assert begin == 147_900 * MS
    assert found[:3] == [(begin, '/mode'), (begin, '/tf_static'), (begin, '/tf_static')]
    assert found[3] == (begin, '/a')
    assert len(found) == 3 + 43
    assert 'is false at 150.000 s' in capsys.readouterr().out
    (report,) = checked(part, (RequestedFormula(formula),)).formulas
    assert report.episodes[0].decided_at == START + 150 * S


def test_damage_is_in_the_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'flight.mcap'
    numbers = [number for number in range(1, 100) if number not in {50, 51}]
    records = [stored(1, START + n * 100 * MS, float_message(n == 60), n) for n in numbers]
    definition = schema(1, FLOAT, 'float64 data') + channel(1, 1, '/a')
    path.write_bytes(mcap(definition, chunk(records, (START + 100 * MS, START + 9_900 * MS))))
    formula = 'always "/a".data < 1'
    options = ('--formula', formula, '--before', '2', '--after', '1', '-o', tmp_path / 'parts')
    assert run_cut(path, *options) == 0
    assert 'missing by the sequence numbers' in capsys.readouterr().err
    (part,) = (tmp_path / 'parts').iterdir()
    with Bag(path) as whole, Bag(part) as bag:
        list(whole.messages())
        assert [(each.topics, each.first, each.last) for each in bag.losses] == [
            (each.topics, each.first, each.last) for each in whole.losses
        ]
    formulas = (RequestedFormula('always "/a".data < 2'), RequestedFormula(formula))
    holds, breaks = checked(part, formulas).formulas
    assert (holds.outcome, breaks.outcome) == (Outcome.ERROR, Outcome.FALSE)
    late = ('--formula', formula, '--before', '0.8', '-o', tmp_path / 'late')
    assert run_cut(path, *late) == 2
    error = capsys.readouterr().err
    assert 'in a part, the verdict depends on messages that are lost between' in error
    assert error.endswith('; give a longer --before\n')


def test_verdicts_that_need_what_is_cut_away_are_errors(tmp_path: Path) -> None:
    path = tmp_path / 'flight'
    latched_bag(path)
    assert run_cut(path, '--around', '100', '-o', tmp_path / 'parts') == 0
    (part,) = (tmp_path / 'parts').iterdir()
    texts = ('eventually[0 s, 1 s] "/a".data > 5', 'always once[0 s, 1 s] "/a".data > 0')
    for each in checked(part, tuple(map(RequestedFormula, texts))).formulas:
        assert each.outcome is Outcome.ERROR
        assert 'cut from another one' in str(each.error)


EARLIER = 'so it may have begun to hold before'


@pytest.mark.parametrize(
    ('formula', 'every', 'outcome', 'words'),
    [
        ('"/a".data < 9', '"/a".data > 5', Outcome.FALSE, ''),
        ('"/a".data < 99', '"/a".data > 5', Outcome.TRUE, ''),
        ('"/a".data < 99', '"/a".data > 99', Outcome.UNDECIDED, ''),
        ('"/a".data < 99', '"/a".data < 5', Outcome.ERROR, EARLIER),
        ('"/a".data < 0', '"/a".data < 5', Outcome.FALSE, ''),
        ('"/mode".data < 0', '"/mode".data = 7', Outcome.ERROR, EARLIER),
        ('once "/a".data > 9', '"/a".data > 5', Outcome.ERROR, 'looks back'),
        ('"/a".data < 9', 'previous "/a".data > 5', Outcome.ERROR, 'looks back'),
        ('P(normal("/a".data, 1) < 0) > 0.5', '"/a".data < 5', Outcome.FALSE, ''),
    ],
)
def test_episodes_that_begin_in_a_part(
    tmp_path: Path, formula: str, every: str, outcome: Outcome, words: str
) -> None:
    path = tmp_path / 'flight'
    latched_bag(path)
    assert run_cut(path, '--around', '150', '--before', '2', '-o', tmp_path / 'parts') == 0
    (part,) = (tmp_path / 'parts').iterdir()
    requested = (RequestedFormula(formula),)
    report = RecordingJob('', part, requested, MonitoringFiles(), every=every).run()
    assert isinstance(report, RecordingReport)
    (found,) = report.formulas
    assert (found.outcome, words in found.reason) == (outcome, True), found


@pytest.mark.parametrize('is_part', [False, True])
def test_a_trigger_that_holds_at_a_chosen_begin(tmp_path: Path, *, is_part: bool) -> None:
    path = tmp_path / 'flight'
    latched_bag(path)
    assert run_cut(path, '--around', '150', '--before', '2', '-o', tmp_path / 'parts') == 0
    (part,) = (tmp_path / 'parts').iterdir()
    job = RecordingJob(
        '',
        part if is_part else path,
        (RequestedFormula('"/a".data < 99'),),
        MonitoringFiles(),
        every='"/a".data < 99',
        begin=10**9,
    )
    report = job.run()
    assert isinstance(report, RecordingReport)
    assert [each.outcome for each in report.formulas] == [Outcome.TRUE]


def test_a_trace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'trace.csv'
    rows = [f'{time},{int(time == 30)},{"true" if time > 20 else "auto"}' for time in range(10, 60)]
    path.write_text('\n'.join(['time_s,a,mode', *rows, '']))
    options = ('--before', '2', '--after', '1', '-o', tmp_path / 'parts')
    assert run_cut(path, '--formula', 'always a = 0', *options) == 0
    (part,) = (tmp_path / 'parts').iterdir()
    told = "17.000 s to 21.000 s, 5 messages: 'always a = 0' is false at 20.000 s\n"
    assert capsys.readouterr().out == f'{part}: {told}'
    assert part.read_text() == (
        'time_s,a,mode: string\n27,0,true\n28,0,true\n29,0,true\n30,1,true\n31,0,true\n'
    )


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / 'flight.mcap'
    write_bag(path, ([(100, 0, 1)] * 20, [(100, 0, 1)], [(100, 0, 1)]))
    with pytest.raises(RecordingError, match='exists; choose another folder by --output'):
        run_cut(path, '--around', '1', '-o', tmp_path)
    assert run_cut(path, '--formula', 'always "/b".data < 9', '-o', tmp_path / 'parts') == 1
    with pytest.raises(RecordingError, match=r'it ends at 1\.900 s; give an earlier time'):
        run_cut(path, '--around', '9', '-o', tmp_path / 'parts')
    assert not (tmp_path / 'parts').exists()


def test_a_log_of_px4(tmp_path: Path) -> None:
    path = tmp_path / 'log.ulg'
    path.write_bytes(log(range(50)))
    with pytest.raises(RecordingError, match=r'read, not written.*ulog2csv -ts \d+ -te \d+'):
        run_cut(path, '--around', '0', '-o', tmp_path / 'parts')
    assert not (tmp_path / 'parts').exists()
