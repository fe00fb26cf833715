"""Workers of a Dask cluster, found at the address of its scheduler. Dask is an optional package."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.execution.executors import Executor

PACKAGE = __name__.partition(".")[0]
VERSION = version(PACKAGE)
TIMEOUT = 3.0  # [s] for each step of reaching a cluster


def require_address(address: str) -> None:
    """Raise if a text is not an address."""
    if "://" not in address:
        rule = "must be the address of a Dask scheduler, such as tcp://host:8786"
        raise InvalidValueError("cluster", rule, repr(address))


@contextmanager
def open_cluster(address: str) -> Iterator[Executor]:
    """Yield the workers of the Dask cluster whose scheduler has an address, or raise in one line.

    Dask itself passes the units of a worker that dies to another worker.
    """
    require_address(address)
    try:
        import distributed
    except ImportError:
        extra = f"pip install {PACKAGE.replace('_', '-')}[cluster]"
        raise _error(address, f"needs Dask: {extra}") from None
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(
            logging.CRITICAL + 1
        )  # they log errors that are raised anyway

    async def identity() -> Any:
        async with distributed.rpc(address, timeout=TIMEOUT) as server:
            return await asyncio.wait_for(server.identity(), TIMEOUT)

    try:
        with ThreadPoolExecutor(1) as apart:  # as in a notebook, this thread may have a loop
            apart.submit(asyncio.run, identity()).result()  # a failing client would stay half open
        client = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except Exception as error:  # any error of Dask with the address or the answer there
        raise _error(address, f"cannot be used: {_reason(error)}") from None

    def compute(function: Callable[[Any], Any], units: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        try:
            # The scheduler, which unpickles what it passes on, need not import a user's modules.
            packed = [distributed.protocol.pickle.dumps((function, unit)) for unit in units]
            futures = client.map(_compute, packed, pure=False)
            indices = {future.key: index for index, future in enumerate(futures)}
            for future in distributed.as_completed(futures, loop=client.loop):
                yield indices[future.key], future.result()
        except distributed.KilledWorker as error:
            rule = f"lost a worker each of the {error.allowed_failures + 1} times it tried a unit"
            raise _error(address, rule) from None
        except CancelledError:
            raise _error(address, "has lost its scheduler") from None

    with client:
        _require_same_package(client, address)
        yield compute


def _compute(packed: bytes) -> Any:
    """Compute a unit in a worker, or raise in one line if its modules are not there."""
    import distributed

    try:
        function, unit = distributed.protocol.pickle.loads(packed)
    except Exception as error:
        thing = f"worker {distributed.get_worker().address} of the cluster"
        rule = f"must be able to import what it computes, as the modules of controllers: {error}"
        raise AflMujocoError(thing, rule) from None
    return function(unit)


def _require_same_package(client: Any, address: str) -> None:
    """Raise unless there is a worker, and every worker and the scheduler have this version."""
    place = "scheduler"
    try:
        there = {client.run_on_scheduler(version, PACKAGE)}
        place = "workers"
        client.wait_for_workers(1, timeout=TIMEOUT)
        there |= {*client.run(version, PACKAGE).values()}
    except TimeoutError:
        raise _error(address, "has no workers") from None
    except Exception as error:  # another Python there, no such package, a worker that just died
        rule = f"cannot run this package on its {place}: {_reason(error)}"
        raise _error(address, rule) from None
    for found in sorted(there - {VERSION}):
        raise _error(address, f"must have {PACKAGE} {VERSION} installed", found)


def _error(address: str, rule: str, value: object = None) -> AflMujocoError:
    """Return the error of a cluster."""
    return AflMujocoError(f"cluster {address}", rule, value)


def _reason(error: Exception) -> str:
    """Return what an error says, in one line."""
    silent = "no answer" if isinstance(error, TimeoutError) else type(error).__name__
    return " ".join(str(error).split()) or silent
