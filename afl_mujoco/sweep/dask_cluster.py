"""Workers of a Dask cluster: started here, or found at an address. Dask is an optional package."""

from __future__ import annotations

import asyncio
import logging
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import ExitStack, contextmanager
from typing import Any
from urllib.parse import urlsplit

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.sweep.processes import UNITS_PER_WORKER, interrupts_held

LOCAL = "local"
PACKAGE = __name__.partition(".")[0]
TIMEOUT = 3.0  # [s] for each step of reaching a cluster
GRACE = 0.1  # [s] for a worker started here to end by itself when the work is broken off
NOISE = ("distributed", "distributed.client", "tornado.application")


class DaskWorkers:
    """Workers of a cluster that compute units.

    Parameters
    ----------
    client
        Connected to the cluster.
    cluster
        What the user calls the cluster.
    """

    def __init__(self, client: Any, cluster: str) -> None:
        self._client = client
        self._cluster = cluster

    @property
    def window(self) -> int:
        """Units that keep every worker busy, of those there are at present."""
        try:
            threads: int = sum(self._client.nthreads().values())
        except (OSError, CancelledError):
            raise self._lost() from None
        return UNITS_PER_WORKER * max(threads, 1)

    def submit(self, function: Callable[[Any], Any], unit: Any, /) -> Future[Any]:
        """Have ``function(unit)`` computed; Dask itself gives it to another worker if one dies.

        Parameters
        ----------
        function, unit
            As of `Executor.submit`.
        """
        remote = self._client.submit(function, unit, pure=False)
        loop = self._client.loop.asyncio_loop
        return asyncio.run_coroutine_threadsafe(self._outcome(remote), loop)

    async def _outcome(self, remote: Any) -> Any:
        """Wait for the result of a Dask future."""
        from distributed import KilledWorker

        try:
            return await remote
        except KilledWorker as error:  # Dask has given up
            raise BrokenExecutor(str(error)) from None
        except CancelledError:
            raise self._lost() from None

    def _lost(self) -> AflMujocoError:
        """Return the error of a cluster that is gone."""
        return _error(self._cluster, "has lost its scheduler")


@contextmanager
def open_cluster(workers: int, cluster: str) -> Iterator[DaskWorkers]:
    """Give the workers of a Dask cluster.

    Parameters
    ----------
    workers
        Processes of a local cluster; one with an address has its own.
    cluster
        ``"local"``, or the address ``"tcp://host:port"`` of a scheduler.

    Yields
    ------
    DaskWorkers
        What computes units.

    Raises
    ------
    AflMujocoError
        If the cluster cannot be used: its address is malformed or does not answer, it has no
        worker, or Dask or this package is missing at an end.
    """
    host_and_port = None if cluster == LOCAL else _host_and_port(cluster)
    try:
        import distributed
    except ImportError:
        extra = f"pip install {PACKAGE.replace('_', '-')}[cluster]"
        raise _error(cluster, f"needs Dask: {extra}") from None
    with ExitStack() as stack:
        stack.enter_context(_silence())
        if host_and_port is None:
            server = stack.enter_context(_local_cluster(distributed, workers))
        else:
            _require_scheduler(distributed, cluster, *host_and_port)
            server = cluster
        client = _connected(distributed, server, cluster)
        stack.callback(client.close)
        _require_same_package(client, cluster)
        yield DaskWorkers(client, cluster)


@contextmanager
def _local_cluster(distributed: Any, workers: int) -> Iterator[Any]:
    """Give a cluster of processes of one thread each; they end at once if the block raises."""
    import dask

    with ExitStack() as stack:
        folder = tempfile.TemporaryDirectory(prefix="afl-mujoco-", ignore_cleanup_errors=True)
        stack.enter_context(folder)
        no_variables: dict[str, Any] = {"distributed.nanny.pre-spawn-environ": {}}
        stack.enter_context(dask.config.set(no_variables))  # Dask would set them here as well
        with interrupts_held():
            try:
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    local_directory=folder.name,
                    silence_logs=logging.CRITICAL,
                )
            except (OSError, RuntimeError) as error:
                raise _error(LOCAL, f"cannot be started: {error}") from None
            stack.callback(cluster.close)
            stack.push(lambda kind, *_: cluster.sync(_end_workers, cluster) if kind else None)
        yield cluster


async def _end_workers(cluster: Any) -> None:
    """End the workers of a local cluster, whatever they do."""
    nannies = cluster.workers.values()
    await asyncio.gather(*(nanny.close(timeout=GRACE) for nanny in nannies))


def _host_and_port(cluster: str) -> tuple[str, int]:
    """Return the parts of an address, or raise if it is malformed."""
    try:
        parts = urlsplit(cluster)
        host, port = parts.hostname, parts.port
    except ValueError:  # of a port that is no number, for example
        host, port = None, None
    if (
        not host
        or not port
        or cluster.lower() not in (f"tcp://{host}:{port}", f"tcp://[{host}]:{port}")
    ):
        raise InvalidValueError("cluster", "must be local or tcp://host:port", repr(cluster))
    return host, port


def _require_scheduler(distributed: Any, cluster: str, host: str, port: int) -> None:
    """Raise if no scheduler is at an address; a name or a network may be slow to say so."""
    problems = ["cannot be reached: no answer"]

    def ask() -> None:
        problems[:] = _problems(distributed, cluster, host, port)

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(2.0 * TIMEOUT)
    if problems:
        raise _error(cluster, problems[0])


def _problems(distributed: Any, cluster: str, host: str, port: int) -> list[str]:
    """Return what is wrong with an address, found without leaving a client half open."""
    try:
        socket.create_connection((host, port), TIMEOUT).close()
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no such name"
        return [f"cannot be reached: {(reason or str(error)).lower()}"]

    async def kind() -> Any:
        async with distributed.rpc(cluster, timeout=TIMEOUT) as server:
            return (await asyncio.wait_for(server.identity(), TIMEOUT))["type"]

    try:
        found = asyncio.run(kind())
    except Exception:  # whatever Dask makes of the answer of something else
        found = None
    return [] if found == "Scheduler" else ["is no Dask scheduler"]


def _connected(distributed: Any, server: Any, cluster: str) -> Any:
    """Return a client of a cluster that has a worker."""
    try:
        client = distributed.Client(server, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ImportError) as error:
        raise _error(cluster, f"cannot be used: {error}") from None
    try:
        client.wait_for_workers(1, timeout=TIMEOUT)
    except TimeoutError:
        client.close()
        raise _error(cluster, "has no workers") from None
    return client


def _require_same_package(client: Any, cluster: str) -> None:
    """Raise if a worker or the scheduler cannot import this package, or imports another version."""

    def installed(name: str = PACKAGE) -> str:  # a local function travels as its code
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version(name)
        except PackageNotFoundError:
            return "none"

    wanted = installed()
    try:
        there = {client.run_on_scheduler(installed), *client.run(installed).values()}
    except Exception as error:  # another Python there, for example, or a worker that has just died
        reason = " ".join(str(error).split()) or type(error).__name__
        raise _error(cluster, f"cannot run this package: {reason}") from None
    for found in sorted(there - {wanted}):
        raise _error(cluster, f"must have {PACKAGE} {wanted} installed", found)


def _error(cluster: str, rule: str, value: object = None) -> AflMujocoError:
    """Return the error of a cluster, which the user called so."""
    return AflMujocoError(f"cluster {cluster}", rule, value)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep Dask from writing on stderr what is raised anyway."""
    loggers = [logging.getLogger(name) for name in NOISE]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
