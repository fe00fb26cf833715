import gc
import signal
import threading
import time

import pytest

from afl_mujoco.pool import Task, share


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 31, 32, 100])
def test_every_item_is_done_once_and_counted(threads: int, count: int) -> None:
    done, counted, callers = [0] * count, [], set()

    def task(part: slice) -> None:
        for i in range(part.start, part.stop):
            done[i] += 1

    def progress(items: int) -> None:
        counted.append(items)
        callers.add(threading.get_ident())

    share(count, [task] * threads, progress, part=7)
    assert done == [1] * count and sum(counted) == count
    assert max(counted, default=0) <= 7 and callers <= {threading.get_ident()}


def test_a_task_does_one_part_at_a_time_and_all_tasks_are_used() -> None:
    busy = [threading.Lock() for _ in range(3)]
    used = set()

    def task_of(who: int) -> Task:
        def task(part: slice) -> None:
            assert busy[who].acquire(blocking=False)
            used.add(who)
            time.sleep(1e-3)
            busy[who].release()

        return task

    share(60, [task_of(who) for who in range(3)], part=1)
    assert used == {0, 1, 2}


def test_the_error_of_the_first_item_is_raised_whichever_thread_was_quicker() -> None:
    begun = []

    def task(part: slice) -> None:
        begun.append(part.start)
        time.sleep(0.02 if part.start == 3 else 0.0)
        if part.start in (3, 4):
            raise ValueError(part.start)

    for _ in range(20):
        begun.clear()
        with pytest.raises(ValueError, match=r"^3$"):
            share(1000, [task] * 2, part=1)
        assert len(begun) < 1000


def test_ctrl_c_stops_after_the_parts_that_are_under_way() -> None:
    begun = []

    def task(part: slice) -> None:
        begun.append(part.start)
        time.sleep(2e-3)

    gc.collect()  # an interrupt that comes while Python calls back weak references is lost
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.05, signal.raise_signal, (signal.SIGINT,))
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            share(1000, [task] * 2, part=1)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)
    assert 0 < len(begun) < 300
