"""Work in processes: parsers of ontologies, SPARQL and reasoners cannot be interrupted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dyknow_common import ExitCode
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics.errors import SemanticsError


@dataclass(frozen=True, slots=True)
class Work:
    """A call of a function in a worker process.

    Args:
        function: can be imported by its name; arguments and result can be pickled.
        arguments: the arguments of the function.
        task: what is done, in messages.
        limit_s: the seconds after which it is killed.
        mend: what to do if it takes too long.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    task: str
    limit_s: float
    mend: str

    def run(self, pool: WorkerPool) -> Any:
        """Return the result of the function, or raise its error.

        Raises:
            SemanticsError: TIMEOUT, if it takes too long; UNAVAILABLE, if the process is stopped or
                ends by itself; INVALID_ARGUMENT, if it needs too much memory or too deep a stack.
            RuntimeError: with the traceback of an unexpected exception.
        """
        try:
            return pool.run(self.function, self.arguments, self.limit_s)
        except TimeoutError:
            raise SemanticsError(
                f'{self.task} did not finish within {self.limit_s:g} s; {self.mend}',
                ExitCode.TIMEOUT,
            ) from None
        except ChildProcessError as error:
            message = f'{self.task} has failed: {error}'
            raise SemanticsError(message, ExitCode.UNAVAILABLE) from None
        except MemoryError:
            megabytes = (pool.memory or 0) // 1024**2
            raise SemanticsError(
                f'{self.task} needs more than {megabytes:,} MiB of memory; {self.mend}'
            ) from None
        except RecursionError:
            raise SemanticsError(f'{self.task} nests too deeply; make it flatter') from None
        except RuntimeError as error:
            raise RuntimeError(f'{self.task} has failed:\n{error}') from None
