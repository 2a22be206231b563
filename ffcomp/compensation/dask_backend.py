"""A Dask cluster as the place where tasks run. Its workers need ffcomp, of the same version, and none of our files."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import contextmanager
from typing import Any

from ffcomp.errors import FfcompError
from ffcomp.version import __version__

try:
    from distributed import Client, KilledWorker
    from distributed.comm import get_address_host_port
    from joblib._dask import DaskDistributedBackend
except ImportError:
    raise FfcompError("A cluster needs Dask: pip install 'ffcomp[dask]'.") from None

CONNECT_S = 10


class Cluster(DaskDistributedBackend):
    """joblib's own backend for Dask waits forever for a task whose worker has died; this one raises.

    NOTE: seen with joblib 1.6: an error that Dask reports reaches the future, but not the callback that is waited for.
    """

    def effective_n_jobs(self, n_jobs: int) -> int:
        """At least two: of one, joblib would think that it means this very process."""
        return max(2, super().effective_n_jobs(n_jobs))

    def submit(self, func: Callable[[], Any], callback: Callable[[Any], None]) -> Future[Any]:
        """Submit a task, and report its error to whoever waits."""
        future: Future[Any] = super().submit(func, callback)
        future.add_done_callback(lambda done: callback(done.exception()) if done.exception() else None)
        return future

    def retrieve_result_callback(self, out: Any) -> Any:
        """Return a task's result, or raise its error as one of ours."""
        if isinstance(out, KilledWorker):
            raise BrokenExecutor("The workers of the cluster died over it, perhaps for want of memory.") from out
        if isinstance(out, CancelledError):
            raise FfcompError("The cluster was lost.") from out
        if isinstance(out, BaseException):
            raise FfcompError(f"The cluster has failed ({type(out).__name__}: {out}).") from out
        return super().retrieve_result_callback(out)


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Connect to the cluster whose scheduler is at this address, and check its workers."""
    for name in ("distributed", "distributed.client"):  # our own errors report it once
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        get_address_host_port(address, strict=True)
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise FfcompError(f"There is no Dask scheduler at {address}: {error}.") from error
    with client:
        _check_workers(client, address)
        yield Cluster(client=client, wait_for_workers_timeout=CONNECT_S)


def _check_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
        versions = client.run(_version)
    except TimeoutError as error:
        raise FfcompError(f"The Dask scheduler at {address} has no workers.") from error
    except Exception as error:  # Dask raises just that for what it could not import there
        advice = f"Install ffcomp {__version__} on all of them."
        raise FfcompError(f"The workers at {address} cannot run ffcomp: {error}. {advice}") from error
    for worker, version in versions.items():
        if version != __version__:
            advice = "They may write other bytes; install the same."
            raise FfcompError(f"The worker {worker} has ffcomp {version}, and this is {__version__}. {advice}")


def _version() -> str:
    return __version__
