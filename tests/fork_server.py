"""Processes of our executables for tests, forked from one that has imported what they need.

An executable imports for half a second of processor time before it works, and the tests start
hundreds of them. `ForkingPopen`, in the place of `subprocess.Popen`, starts them in another way.
Only their command line and environment in /proc differ, not their names:

    test process      sends command line, environment, stdin, stdout and stderr to the server
    server            has imported the modules of all executables, and forks
      helper          forks, and ends: its child becomes one of the test process, a subreaper
        executable    runs the installed script, as Python would

An executable that starts others, such as `dyknow up`, or worker processes has a server of its own,
which is forked before it has threads. Other programs are started as ever, and so are executables
with an option that a fork cannot have.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import importlib
import inspect
import json
import os
import resource
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import distribution
from pathlib import Path
from typing import Any, Self

from dyknow_command.verbs import VERBS

ROOT = Path(__file__).parent.parent

READ_AT_START = ('PYTHON', 'LD_', 'LC_', 'LANG')
"""The beginnings of variables that a process reads before it runs a script."""

FORKABLE = {
    'preexec_fn': None, 'pass_fds': (), 'shell': False, 'gid': None, 'gids': None, 'uid': None,
    'umask': -1, 'process_group': -1,
}  # fmt: skip
"""The options that a process may not have, with their defaults."""

STARTING = {'dyknow', 'dyknow_nodes', 'ontology_manager', 'uav_demo', 'uav_plan'}
"""The executables that start processes."""

WORKER = [sys.executable, '-P', '-m', 'dyknow_common.worker_program']
"""The command line of a worker process; the bytes of memory that it may use follow."""

LATE = ('dyknow_common.ros', WORKER[-1], 'owlready2.sparql.main')
"""Modules that executables import when they need them; the last one takes 0.1 s for its tables."""

LEAST_MEMORY = 512 << 20
"""The least limit of a worker that is forked: the default. Tests of the limit have smaller ones."""

MAX_REQUEST = 200_000
PR_SET_NAME = 15
PR_SET_CHILD_SUBREAPER = 36


class ForkingPopen(subprocess.Popen):  # type: ignore[type-arg]
    """A process, forked from the server if it is one of our executables."""

    is_enabled = False
    server: Server | None = None

    def _execute_child(self, *arguments: Any) -> None:
        names = list(inspect.signature(super()._execute_child).parameters)  # type: ignore[misc]
        given = dict(zip(names, arguments, strict=True))
        if not (self.is_enabled and is_forkable(given)):
            super()._execute_child(*arguments)  # type: ignore[misc]
            return
        ends = [given[name] for name in ('p2cread', 'c2pwrite', 'errwrite')]
        streams = [default if end == -1 else end for default, end in enumerate(ends)]
        if ForkingPopen.server is None:
            ForkingPopen.server = Server.start()
        self.pid = ForkingPopen.server.fork(given, streams)
        self._child_created = True
        pipes = ('p2cread', 'p2cwrite', 'c2pread', 'c2pwrite', 'errread', 'errwrite')
        self._close_pipe_fds(*(given[name] for name in pipes))  # type: ignore[attr-defined]


def is_forkable(given: Mapping[str, Any]) -> bool:
    """Return True if a process is an executable of ours without unusual options."""
    command, environment = given['args'], given['env'] or os.environ
    return (
        isinstance(command, list | tuple)
        and given['executable'] in {None, command[0]}
        and (is_executable(command[0]) or is_worker(command))
        and all(given[name] == default for name, default in FORKABLE.items())
        and read_at_start(environment) == read_at_start(os.environ)
    )


def is_executable(path: object) -> bool:
    """Return True for the installed script of an executable of ours."""
    script = Path(str(path))
    return script.parent in FOLDERS and script.is_file()


def is_worker(command: Sequence[object]) -> bool:
    """Return True for the command line of a worker process that has memory enough for a fork."""
    program, limits = command[: len(WORKER)], command[len(WORKER) :]
    return program == WORKER and all(int(str(each)) >= LEAST_MEMORY for each in limits)


def read_at_start(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that a process reads at its start."""
    return {name: value for name, value in environment.items() if name.startswith(READ_AT_START)}


PACKAGES = [path.parent.name for path in ROOT.glob('dyknow_*/setup.py')]

FOLDERS = {
    ROOT / 'install' / package / folder
    for package in PACKAGES
    for folder in ('bin', f'lib/{package}')
}
"""The folders of the installed scripts."""


class Server:
    """A process that forks, as the process sees it whose children are made."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    @classmethod
    def start(cls) -> Self:
        """Start the server of the test process."""
        connection, end = connected()
        # Tests find the processes of a domain by this variable.
        environment = {k: v for k, v in os.environ.items() if k != 'ROS_DOMAIN_ID'}
        command = [sys.executable, __file__, str(end.fileno())]
        server = cls(connection)
        server._process = subprocess.Popen(command, pass_fds=[end.fileno()], env=environment)
        end.close()
        return server

    def fork(self, given: Mapping[str, Any], streams: list[int]) -> int:
        """Start an executable, given the options of Popen, and return its process id."""
        request = {
            'command': [os.fspath(each) for each in given['args']],
            'environment': dict(given['env'] or os.environ),
            'folder': os.fspath(given['cwd'] or Path.cwd()),
            'is_session': given['start_new_session'],
            'parent': os.getpid(),
        }
        libc = ctypes.CDLL(None)
        with self._lock:
            # A process whose parent has ended becomes a child of its nearest subreaper.
            libc.prctl(PR_SET_CHILD_SUBREAPER, 1)
            try:
                socket.send_fds(self._connection, [json.dumps(request).encode()], streams)
                answer = self._connection.recv(100)
            finally:
                libc.prctl(PR_SET_CHILD_SUBREAPER, 0)
        if not answer:
            raise AssertionError('the server that forks has ended')
        return int(answer)


def connected() -> tuple[socket.socket, socket.socket]:
    """Return the end of a process and the end of its server."""
    ours, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MAX_REQUEST)
    return ours, end


def import_all() -> None:
    """Import the modules of all executables, for which `subprocess.Popen` forks too."""
    subprocess.Popen = ForkingPopen  # type: ignore[misc]
    modules = {
        script.module
        for package in PACKAGES
        for script in distribution(package).entry_points.select(group='console_scripts')
    }
    for module in (*modules, *(verb.module for verb in VERBS.values()), *LATE):
        importlib.import_module(module)
    gc.collect()
    gc.freeze()  # Collections would copy the memory of what is imported.


def serve(connection: socket.socket) -> None:
    """Fork processes until the parent ends; return in each of them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        message, streams, _, _ = socket.recv_fds(connection, MAX_REQUEST, 3)
        if not message:
            os._exit(0)
        helper = os.fork()
        if helper == 0:
            if os.fork() != 0:
                os._exit(0)
            become(json.loads(message), streams, connection)
            return
        os.waitpid(helper, 0)
        for descriptor in streams:
            os.close(descriptor)


def become(request: Mapping[str, Any], streams: list[int], connection: socket.socket) -> None:
    """Have the state of a process that was started with a command line."""
    while os.getppid() != request['parent']:
        time.sleep(0.0005)
    if request['is_session']:
        os.setsid()
    for number, descriptor in enumerate(streams):
        os.dup2(descriptor, number)
    connection.send(str(os.getpid()).encode())
    connection.detach()
    os.closerange(3, 100)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(request['folder'])
    os.environ.clear()
    os.environ.update(request['environment'])
    sys.argv = request['command']
    executable = Path(sys.argv[0]).name
    if executable in STARTING and serve_beside():
        return
    library = ctypes.CDLL(None)
    library.prctl(PR_SET_NAME, executable.encode())
    # Libraries would end threads that are left to the server, and crash.
    library.on_exit(library._exit, None)
    for name, number, mode in (('stdin', 0, 'r'), ('stdout', 1, 'w'), ('stderr', 2, 'w')):
        buffering = 1 if name == 'stderr' or os.isatty(number) else -1
        stream = open(number, mode, buffering, encoding='utf-8', closefd=False)  # noqa: SIM115
        setattr(sys, name, stream)
        setattr(sys, f'__{name}__', stream)


def serve_beside() -> bool:
    """Fork a server for the children of this process; return True in each of them."""
    ours, end = connected()
    process = os.fork()
    if process != 0:
        end.close()
        ForkingPopen.server, ForkingPopen.is_enabled = Server(ours), True
        atexit.register(end_child, process)
        return False
    ours.close()
    os.setsid()  # Signals are for the executable alone; the server ends with it.
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in range(3):
        os.dup2(nothing, number)
    os.close(nothing)
    serve(end)
    return True


def end_child(process: int) -> None:
    """End a child, so that no process is left for whoever inherits the children of this one."""
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)


def run() -> None:
    """Run the program of a command line."""
    if is_worker(sys.argv):
        # A fork has memory already, which a fresh process would not have.
        pages = int(Path('/proc/self/statm').read_text(encoding='utf-8').split()[0])
        limits = [int(each) + pages * resource.getpagesize() for each in sys.argv[len(WORKER) :]]
        sys.argv = [WORKER[-1], *map(str, limits)]
        importlib.import_module(WORKER[-1]).main()
    else:
        runpy.run_path(sys.argv[0], run_name='__main__')


if __name__ == '__main__':
    import_all()
    serve(socket.socket(fileno=int(sys.argv[1])))
    run()
