from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_semantics'
NODES = ('ontology_manager', 'stream_semantics_manager', 'semantic_matching_engine')

ScriptWriter.template = script_template(NODES)

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={'dyknow_semantics': ['py.typed', '**/*.lark', '**/*.owl']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='Semantic grounding for DyKnow: ontologies, annotations of streams, matching, and their nodes.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'ontology_manager = dyknow_semantics.ros.ontology_manager:main',
            'stream_semantics_manager = dyknow_semantics.ros.stream_semantics_manager:main',
            'semantics = dyknow_semantics.ros.semantics:main',
            'semantic_matching_engine = dyknow_semantics.ros.semantic_matching_engine:main',
        ],
    },
)
