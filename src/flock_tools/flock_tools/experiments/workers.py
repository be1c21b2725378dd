# SPDX-License-Identifier: Apache-2.0
"""The workers that compute: the cores of this machine, or a Dask cluster."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from flock_sim.errors import FlockError

ADDRESS = re.compile(r"(tcp|tls|wss?)://(\[[0-9a-fA-F:]+\]|[^\s/:\[\]]+):[0-9]{1,5}")

TIMEOUT = 10.0
"""Longest wait for a cluster's scheduler, and then for its first worker, in s."""


@dataclass(frozen=True)
class Workers:
    """An executor of parallel functions, and the number that it runs at once."""

    executor: Executor
    count: int
    local: bool
    """Whether the workers share the memory of this process."""


@contextmanager
def workers(scheduler: str | None) -> Iterator[Workers]:
    """Give the cores of this machine, or the cluster of the Dask scheduler at an address.

    Kernels release the interpreter lock, so threads are enough on one machine. Raises FlockError if
    no scheduler answers or if it has no workers.
    """
    if scheduler is None:
        count = len(os.sched_getaffinity(0))
        executor = ThreadPoolExecutor(count)
        try:
            yield Workers(executor, count, local=True)
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
        return
    if not ADDRESS.fullmatch(scheduler):
        raise FlockError(
            f"--scheduler {scheduler}: must be an address such as tcp://127.0.0.1:8786, with "
            "tcp, tls, ws or wss, a host and a port"
        )
    import distributed  # takes half a second

    connect: Any = distributed.Client  # which has no types

    try:
        client = connect(scheduler, timeout=TIMEOUT, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise FlockError(
            f"--scheduler {scheduler}: no Dask scheduler answers there within {TIMEOUT:g} s "
            f"({type(error).__name__}); give its address, such as tcp://127.0.0.1:8786"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
        except TimeoutError as error:
            raise FlockError(
                f"--scheduler {scheduler}: has no workers, and got none within {TIMEOUT:g} s; "
                f"start one with `./flock python -m distributed.cli.dask_worker {scheduler}`"
            ) from error
        yield Workers(client.get_executor(), sum(client.nthreads().values()), local=False)
