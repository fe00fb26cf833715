"""Many units of work: in this process, on threads, processes of this machine, or a Dask cluster."""

from __future__ import annotations

import asyncio
import gc
import io
import logging
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from afl_mujoco.errors import AflMujocoError, InvalidValueError, require_count, warning_in_one_line

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

_came: list[int] = []  # the Ctrl-C's since the outermost `interrupts_noted` began


@contextmanager
def interrupts_noted() -> Iterator[None]:
    """Note each Ctrl-C of the block, so that `is_interrupt` knows what a library made of one.

    A library may turn it into an error of its own without a trace, as ctypes does under PyOpenGL.
    """
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return

    def note(number: int, frame: FrameType | None) -> None:
        _came.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _came.clear()


def is_interrupt(error: BaseException | None) -> bool:
    """Return whether a Ctrl-C caused an error, as while a library is loaded."""
    if _came:
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


@contextmanager
def interrupts_put_off() -> Iterator[None]:
    """Put off a Ctrl-C to the end of the block, where it is raised even if the block raises."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda n, _: came.append(n))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
        if came:
            signal.raise_signal(signal.SIGINT)


Unit = TypeVar("Unit")
Result = TypeVar("Result")

Executor: TypeAlias = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]
"""Yields index and result of a function for each unit as it is done, or raises a unit's error.

A worker imports the function by its name; units and results are pickled.
"""


def in_process(
    function: Callable[[Unit], Result], units: Sequence[Unit]
) -> Iterator[tuple[int, Result]]:
    """Compute one unit after the other, here."""
    return enumerate(map(function, units))


MOST_WORKERS = 1024


def require_workers(workers: object) -> None:
    """Raise unless there can be so many workers."""
    require_count("workers", workers, 1, MOST_WORKERS)


@contextmanager
def open_executor(workers: int, cluster: str | None = None) -> Iterator[Executor]:
    """Yield an executor, and end its workers: at once if the block raises, a Ctrl-C included.

    One worker is this process, more are processes of this machine; `cluster`, the address
    ``"tcp://host:port"`` of a Dask scheduler, replaces them by the workers of that cluster.
    """
    require_workers(workers)
    if cluster is not None:
        with open_cluster(cluster) as compute:
            yield compute
    elif workers == 1:
        yield in_process
    else:
        with open_processes(workers) as compute:
            yield compute


def compute_all(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    executor: Executor,
    progress: Callable[[int], None] = lambda index: None,
    kept: dict[int, Result] | None = None,
) -> list[Result]:
    """Return the results of all units, in their order, whichever is done first.

    `progress` is called with the index of each unit as it is done. Units in `kept` are done
    already; what is done is in it at once, also if an error or a Ctrl-C ends the rest.
    """
    results: dict[int, Result] = {} if kept is None else kept
    for index in results:
        progress(index)
    missing = [index for index in range(len(units)) if index not in results]
    for place, result in executor(function, [units[index] for index in missing]):
        results[missing[place]] = result
        progress(missing[place])
    return [results[index] for index in range(len(units))]


SAFE_PATH = "PYTHONSAFEPATH"

MAX_DEATHS = 4  # deaths of workers after which a computation is given up: it seems to kill them


_idle: dict[int, ProcessPoolExecutor] | None = None
"""Pools that wait for their next use, by their number of workers; None outside `kept_processes`."""


@contextmanager
def kept_processes() -> Iterator[None]:
    """Keep worker processes from one use within the block to the next: to start them takes long."""
    global _idle
    _idle = {}
    try:
        yield
    finally:
        pools, _idle = _idle, None
        for pool in pools.values():
            pool.shutdown()


def waiting_workers() -> int:
    """Return how many processes are idle, or 1: for work that is too short to start any."""
    return max(_idle or (1,))


@contextmanager
def open_processes(workers: int) -> Iterator[Executor]:
    """Yield an executor on worker processes, and end them; at once if the block raises.

    Within `kept_processes` a block that does not raise leaves them to the next.
    """
    from concurrent.futures import as_completed
    from concurrent.futures.process import BrokenProcessPool

    pool = (_idle or {}).pop(workers, None) or _new_pool(workers)

    def compute(function: Callable[[Any], Any], units: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        nonlocal pool
        left = dict(enumerate(units))
        for _ in range(MAX_DEATHS):
            try:
                with interrupts_held():  # processes are started here
                    sent = {i: pickle.dumps((function, unit)) for i, unit in left.items()}
                    futures = {pool.submit(_done, unit): i for i, unit in sent.items()}
                for future in as_completed(futures):
                    index = futures.pop(future)
                    result = future.result()
                    del left[index]
                    yield index, result
                return
            except BrokenProcessPool:
                pool.shutdown()
                pool = _new_pool(workers)
        rule = f"died {MAX_DEATHS} times, with {len(left)} of {len(units)} units not done"
        raise AflMujocoError("worker process", f"{rule}; is there enough memory?")

    try:
        yield compute
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    if _idle is None or workers in _idle:
        pool.shutdown(cancel_futures=True)
    else:
        _idle[workers] = pool


def _done(sent: bytes) -> Any:
    """Return the result of a unit; what cannot be unpacked is its error, and kills no process."""
    function, unit = pickle.loads(sent)
    return function(unit)


def _new_pool(workers: int) -> ProcessPoolExecutor:
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    spawn = multiprocessing.get_context("spawn")
    in_one_line = warnings.formatwarning is warning_in_one_line
    arguments = in_one_line, gc.get_threshold()
    with _safe_path():  # its locks start a process too
        return ProcessPoolExecutor(workers, spawn, initializer=_prepare, initargs=arguments)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Have processes started within the block import nothing from the working directory at first.

    They get the path of this process later, once Python's own modules are imported.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        del os.environ[SAFE_PATH]
        if before is not None:
            os.environ[SAFE_PATH] = before


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Put off a Ctrl-C to the end of the block, and block it for good in processes started within.

    A terminal sends the signal to every process of a command; only this one is to handle it. A mask
    that a worker inherits holds from its first instruction on, which a handler of its own would
    not. In this process the mask alone is not enough: a thread of a numerical library may take the
    signal.
    """
    from multiprocessing.resource_tracker import ensure_running

    with _safe_path():
        ensure_running()  # started within the block, it would let the signal through again
    with _safe_path(), interrupts_put_off():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepare(in_one_line: bool, collected_after: tuple[int, int, int]) -> None:
    """Have this worker warn, print and collect garbage as its parent does, and end with it."""
    gc.set_threshold(*collected_after)
    if in_one_line:
        warnings.formatwarning = warning_in_one_line
    for stream in (sys.stdout, sys.stderr):  # what a controller prints must not be its error
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    threading.Thread(target=_exit_after_parent, daemon=True).start()


def _exit_after_parent() -> None:
    import multiprocessing

    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def on_threads(
    function: Callable[[Unit], Result], items: Iterable[Unit], threads: int
) -> list[Result]:
    """Return what a function makes of each item, in order; one thread is that of the caller.

    An error or a Ctrl-C stops the work once every thread has done its item; of several errors, that
    of the first item is raised.
    """
    from concurrent.futures import ThreadPoolExecutor

    if threads == 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        try:
            return [future.result() for future in [pool.submit(function, x) for x in items]]
        finally:
            pool.shutdown(cancel_futures=True)


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
    from concurrent.futures import CancelledError, ThreadPoolExecutor

    require_address(address)
    try:
        import distributed
    except ImportError:
        raise _error(address, "needs Dask: pip install distributed") from None
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(100)  # they log errors that are raised anyway

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
    return AflMujocoError(f"cluster {address}", rule, value)


def _reason(error: Exception) -> str:
    silent = "no answer" if isinstance(error, TimeoutError) else type(error).__name__
    return " ".join(str(error).split()) or silent
