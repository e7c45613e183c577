"""Start the seven nodes of DyKnow for a robot.

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
    'store': ('', 'a folder that keeps changes of the ontology and of the annotations'),
    'reasoner': ('', 'structural, hermit or pellet; the last two need Java'),
}


def files(text):
    """Return the files of a list separated by commas."""
    return tuple(Path(path.strip()).resolve() for path in text.split(',') if path.strip())


def processes(values):
    """Return the nodes of DyKnow."""
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
    """Return the launch description for `ros2 launch`."""
    return launch_description(ARGUMENTS, processes)
