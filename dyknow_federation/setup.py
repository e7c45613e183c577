from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_federation'
NODES = ('federation',)

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
    description='Several hosts: their clocks, links, and what they share.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['federation = dyknow_federation.ros.federation:main']},
)
