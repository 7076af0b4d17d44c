"""Executors: tasks done here, by own processes, or by any `concurrent.futures` executor."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, ProcessPoolExecutor, wait
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")


def results(
    run: Callable[[T], R],
    task: Callable[[int], T],
    wanted: Sequence[int],
    *,
    executor: Executor | None = None,
    workers: int = 1,
    ahead: int | None = None,
) -> Iterator[tuple[int, R]]:
    """(number, run(task(number))) of the numbers wanted, as they are finished.

    executor: such as those of loky, mpi4py or Dask; None: `workers` processes, or this one
    ahead: so many tasks are made before the first result is taken; None: all

    Raises ValueError where a worker died.
    """
    if executor is None and workers == 1:
        for i in wanted:
            yield i, run(task(i))
        return
    pool = executor or ProcessPoolExecutor(
        workers, get_context("spawn"), initializer=_leave_with, initargs=(os.getpid(),)
    )
    left, running = iter(wanted), dict[Any, int]()
    try:
        while True:
            room = None if ahead is None else max(0, ahead - len(running))
            running |= {pool.submit(run, task(i)): i for i in islice(left, room)}
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), _result(future)
    finally:
        if executor is None:
            pool.shutdown(wait=False, cancel_futures=True)


def _result(future: Any) -> Any:
    from concurrent.futures.process import BrokenProcessPool

    try:
        return future.result()
    except BrokenProcessPool:
        raise ValueError(
            "workers: a worker process died (out of memory, or killed); what is finished so far is"
            " kept, repeat the command to continue"
        ) from None


def _leave_with(parent: int) -> None:
    """In a worker: end when the process that started it is gone."""
    import threading
    import time

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
