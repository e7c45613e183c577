"""The messages of tf2, made for tests where tf2 is not installed."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

BUILD = (sys.executable, '-m', 'colcon', 'build', '--merge-install')

FILES = {
    'msg/TFMessage.msg': 'geometry_msgs/TransformStamped[] transforms\n',
    'package.xml': """\
<package format="3">
  <name>tf2_msgs</name>
  <version>0.0.0</version>
  <description>The message of transforms.</description>
  <maintainer email="none@example.org">none</maintainer>
  <license>BSD</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
""",
    'CMakeLists.txt': """\
cmake_minimum_required(VERSION 3.16)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX
  "^rosidl_(generator_cpp|typesupport_cpp|typesupport_fastrtps_cpp|typesupport_introspection_cpp):")
rosidl_generate_interfaces(${PROJECT_NAME} "msg/TFMessage.msg" DEPENDENCIES geometry_msgs)
ament_package()
""",
}


def tf2_is_installed() -> bool:
    """Return True if the messages of tf2 are there without being made."""
    return find_spec('tf2_msgs') is not None


def tf2_environment(folder: Path) -> dict[str, str]:
    """Make the messages of tf2 in a folder, and return the variables by which processes find them.

    This takes some seconds of processor time: only what Python nodes load is made.
    """
    if tf2_is_installed():
        return {}
    for name, text in FILES.items():
        path = folder / 'tf2_msgs' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    subprocess.run(
        [*BUILD, '--cmake-args', '-DBUILD_TESTING=OFF', '-DCMAKE_BUILD_TYPE=Debug'],
        cwd=folder,
        check=True,
        capture_output=True,
    )
    install = folder / 'install'
    (packages,) = install.glob('lib/python3*/site-packages')
    paths = {
        'PYTHONPATH': packages,
        'LD_LIBRARY_PATH': install / 'lib',
        'AMENT_PREFIX_PATH': install,
    }
    return {
        name: os.pathsep.join(filter(None, [str(path), os.environ.get(name)]))
        for name, path in paths.items()
    }
