"""Recordings of robots, and formulas over them, without ROS."""

from dyknow_configuration import RequestedFormula
from dyknow_recordings.black_boxes import (
    BLACK_BOX,
    BlackBoxContent,
    horizon,
    is_bounded,
    read_black_box,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording, load_vocabulary
from dyknow_recordings.evaluation.grounding import FormulaGrounder, GroundedFormula
from dyknow_recordings.evaluation.results import (
    Episode,
    FormulaReport,
    Outcome,
    RecordingReport,
    StateGap,
)
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles, Vocabulary
from dyknow_recordings.health import observe_recording
from dyknow_recordings.reading.bags.bag import Bag
from dyknow_recordings.reading.bags.bag_writing import RecordedMessage, bag_writer, offered_profile
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.messages.definitions import MessageTypes
from dyknow_recordings.reading.opening import (
    add_reading_options,
    message_types,
    open_recording,
)
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
    'BLACK_BOX',
    'Bag',
    'BlackBoxContent',
    'Episode',
    'EpisodeStart',
    'Every',
    'FormulaGrounder',
    'FormulaReport',
    'GroundedFormula',
    'Judgement',
    'MessageColumns',
    'MessageTypes',
    'MonitoringFiles',
    'Outcome',
    'PictureFiles',
    'QualityOfService',
    'RecordedFields',
    'RecordedMessage',
    'RecordedStreams',
    'RecordedTopic',
    'RecordingError',
    'RecordingFault',
    'RecordingReader',
    'RecordingReport',
    'RequestedFormula',
    'StateGap',
    'TopicContent',
    'Vocabulary',
    'add_reading_options',
    'bag_writer',
    'evaluate_recording',
    'horizon',
    'in_order',
    'is_bounded',
    'load_vocabulary',
    'message_types',
    'observe_recording',
    'offered_profile',
    'open_recording',
    'read_black_box',
]
