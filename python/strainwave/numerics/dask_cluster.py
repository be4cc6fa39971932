"""A Dask cluster: its client, and jobs on data that stay on the workers.

`distributed` is imported when a client connects.
"""

from __future__ import annotations

import logging
import pickle
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import Any

from strainwave.errors import (
    InvalidInput,
    NumericalFailure,
    StrainwaveError,
    import_optional,
)
from strainwave.numerics.parallel import configure_worker, limited, raise_if_stopped
from strainwave.version import __version__

_CONNECT_TIMEOUT_S = 10.0  # of the scheduler, at the start and after a lost connection
_WORKER_TIMEOUT_S = 30.0  # without any worker; a nanny restarts one in a few seconds
_WORKER_CHECK_S = 1.0  # between two checks for workers
_POLL_S = 0.02  # between two checks for ended jobs
_SAME_VERSION = "install the same version of strainwave on the scheduler and the workers"


class ClusterFailure(StrainwaveError):  # noqa: N818
    """A cluster cannot run jobs; `problem` and `remedy` are clauses without a full stop."""

    def __init__(self, problem: str, remedy: str | None = None) -> None:
        self.problem, self.remedy = problem, remedy
        super().__init__(problem, remedy)

    def __str__(self) -> str:
        return self.problem


class ClusterLost(ClusterFailure):
    """The connection to the scheduler is lost."""

    def __init__(self) -> None:
        super().__init__("the Dask scheduler is lost", "start it again, and repeat the command")


def load_client() -> Any:
    """The class of clients, with a silent log: lost schedulers are reported by `ClusterLost`.

    Raises `InvalidInput` if Dask is not installed.
    """
    Client = import_optional("distributed", "a cluster", "dask distributed fsspec").Client
    for name in list(logging.root.manager.loggerDict):
        if name.split(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    return Client


@contextmanager
def connected(scheduler: Any) -> Iterator[Any]:
    """A client of a scheduler, by its address such as tcp://host:8786 or its cluster object.

    Raises `InvalidInput` if Dask is not installed or the scheduler does not answer.
    """
    Client = load_client()
    try:
        client = Client(scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InvalidInput(
            f"no Dask scheduler answers ({' '.join(str(error).split())})",
            where=scheduler if isinstance(scheduler, str) else None,
            remedy="start one by `dask scheduler`, or check the address",
        ) from error
    try:
        yield client
    finally:
        with suppress(Exception):  # a lost scheduler does not answer
            client.close(timeout=1.0)


@contextmanager
def connected_call(client: Any) -> Iterator[None]:
    """A call of the scheduler, which may be lost during the call: `ClusterLost`."""
    try:
        yield
    except Exception as error:  # a broken connection is an OSError, a closed client is not
        if isinstance(error, OSError | CancelledError) or client.status == "closed":
            raise ClusterLost from error
        raise


@contextmanager
def distributed(scheduler: str | None) -> Iterator[None]:
    """In this block, jobs that may run on a cluster run on that of a scheduler, if one is given.

    Raises `InvalidInput` if the cluster does not answer or fails.
    """
    if scheduler is None:
        yield
        return
    try:
        with connected(scheduler) as client:
            cluster = Cluster(client)
            cluster.check()
            with limited(cluster=cluster):
                yield
    except ClusterFailure as error:
        raise InvalidInput(str(error), where=scheduler, remedy=error.remedy) from error


class Cluster:
    """Runs jobs on the workers; a datum is sent once while it exists, and stays on a worker."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._sent: dict[int, Any] = {}  # by identity; removed when the datum is deleted

    def check(self) -> None:
        """Raise `ClusterFailure` unless a worker of the same version answers."""
        with connected_call(self._client):
            loaded = self._client.submit(_load, __version__, pickle.dumps(None), pure=False)
        self._gather([loaded])

    def map(
        self, function: Callable[..., tuple[Any, Any]], data: Sequence[object], jobs: Sequence[Any]
    ) -> tuple[list[Any], Callable[[], list[Any]]]:
        """Apply a function to a datum and a job each; it returns a small and a large result.

        Returns the small results, and a function that fetches the large ones, which stay on the
        workers until then. Raises the first error of a job if it is that of a simulation, and
        `ClusterFailure` if the workers cannot run the jobs.
        """
        submit = self._client.submit
        with connected_call(self._client):
            both = [
                submit(_perform, function, self._send(datum), job, pure=False)
                for datum, job in zip(data, jobs, strict=True)
            ]
            small = [submit(_part, each, 0, pure=False) for each in both]
        results = self._gather(small)

        def fetch() -> list[Any]:
            with connected_call(self._client):
                large = [submit(_part, each, 1, pure=False) for each in both]
            return self._gather(large)

        return results, fetch

    def _send(self, datum: object) -> Any:
        """A future of a datum; its pickle stays on the scheduler, in case that a worker dies."""
        key = id(datum)
        if key not in self._sent:
            pickled = pickle.dumps(datum, pickle.HIGHEST_PROTOCOL)
            self._sent[key] = self._client.submit(_load, __version__, pickled, pure=False)
            weakref.finalize(datum, self._sent.pop, key, None).atexit = False
        return self._sent[key]

    def _gather(self, futures: Sequence[Any]) -> list[Any]:
        from distributed import KilledWorker

        self._wait(futures)
        try:
            with connected_call(self._client):
                return list(self._client.gather(futures))
        except (ClusterFailure, InvalidInput, NumericalFailure):
            raise
        except KilledWorker as error:
            raise ClusterFailure(
                f"the Dask workers that evaluated a record died, {error.allowed_failures + 1} in a"
                " row",
                "start workers with more memory or fewer threads",
            ) from error
        except Exception as error:
            raise ClusterFailure(
                f"the Dask workers cannot run strainwave ({type(error).__name__}: {error})",
                _SAME_VERSION,
            ) from error

    def _wait(self, futures: Sequence[Any]) -> None:
        """Wait for the end of jobs. Raises `ClusterFailure` if there are no workers to run them."""
        checked = with_workers = time.monotonic()
        while not all(future.done() for future in futures):
            raise_if_stopped()
            time.sleep(_POLL_S)
            if (now := time.monotonic()) - checked < _WORKER_CHECK_S:
                continue
            checked = now
            with connected_call(self._client):
                if self._client.nthreads():
                    with_workers = now
            if now - with_workers > _WORKER_TIMEOUT_S:
                raise ClusterFailure(
                    f"the Dask cluster has had no worker for {_WORKER_TIMEOUT_S:.0f} s",
                    "start workers by `dask worker` with the address of the scheduler",
                )


def _load(version: str, pickled: bytes) -> object:
    """A datum on a worker."""
    if version != __version__:
        raise ClusterFailure(
            f"a Dask worker has strainwave {__version__}, the command has {version}", _SAME_VERSION
        )
    return pickle.loads(pickled)


def _perform(
    function: Callable[[Any, Any], tuple[Any, Any]], datum: object, job: object
) -> tuple[Any, Any]:
    configure_worker()
    return function(datum, job)


def _part(results: tuple[Any, Any], place: int) -> Any:
    return results[place]
