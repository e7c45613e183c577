"""Starts the seven nodes of DyKnow for one's own robot.

ros2 launch dyknow_bringup dyknow.launch.py ontology:=my.owl annotations:=my.ssl streams:=my.streams
"""

from pathlib import Path

from dyknow_bringup.processes.launching import launch_description
from dyknow_bringup.processes.processes import SystemConfiguration, dyknow_processes

ARGUMENTS = {
    'ontology': ('', 'OWL files, separated by commas'),
    'annotations': ('', 'files in SSL, separated by commas'),
    'streams': ('', 'files in the stream language, separated by commas'),
    'bridges': ('', 'files of bridge rules between the ontologies, separated by commas'),
    'store': ('', 'a folder that keeps what services change of ontology and annotations'),
    'reasoner': ('', 'structural, hermit or pellet; the last two need Java'),
}


def files(text):
    """The files in a list with commas."""
    return tuple(Path(path.strip()).resolve() for path in text.split(',') if path.strip())


def processes(values):
    """The nodes of DyKnow."""
    names = ('ontology', 'annotations', 'streams', 'bridges')
    store = values['store']
    return dyknow_processes(
        SystemConfiguration(
            *(files(values[name]) for name in names),
            store=Path(store).resolve() if store else None,
            reasoner=values['reasoner'],
        )
    )


def generate_launch_description():
    """What `ros2 launch` asks for."""
    return launch_description(ARGUMENTS, processes)
