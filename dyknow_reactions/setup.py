from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_reactions'
NODES = ('black_box_recorder', 'guard')

ScriptWriter.template = script_template(NODES)

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='What follows from verdicts: black boxes, triggers and guards.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'black_box_recorder = dyknow_reactions.ros.black_box.black_box_recorder:main',
            'guard = dyknow_reactions.ros.guard.guard:main',
        ],
    },
)
