"""Recordings of robots, and formulas over them, without ROS."""

from dyknow_configuration import RequestedFormula
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import (
    Episode,
    FormulaReport,
    Outcome,
    RecordingReport,
    StateGap,
)
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles
from dyknow_recordings.reading.bags.bag import Bag, RecordedMessage
from dyknow_recordings.reading.columns import MessageColumns
from dyknow_recordings.reading.contents import TopicContent
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import (
    QualityOfService,
    RecordedFields,
    RecordedTopic,
    RecordingFault,
    RecordingReader,
    in_order,
)
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.files import PictureFiles

__all__ = [
    'Bag',
    'Episode',
    'EpisodeStart',
    'Every',
    'FormulaReport',
    'Judgement',
    'MessageColumns',
    'MonitoringFiles',
    'Outcome',
    'PictureFiles',
    'QualityOfService',
    'RecordedFields',
    'RecordedMessage',
    'RecordedTopic',
    'RecordingError',
    'RecordingFault',
    'RecordingReader',
    'RecordingReport',
    'RequestedFormula',
    'StateGap',
    'TopicContent',
    'evaluate_recording',
    'in_order',
    'open_recording',
]
