# SPDX-License-Identifier: Apache-2.0
"""Who computes: the cores of this machine, or a Dask cluster."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

from flock_sim.errors import FlockError

ADDRESS = re.compile(r"(tcp|tls|wss?)://(\[[0-9a-fA-F:]+\]|[^\s/:\[\]]+):[0-9]{1,5}")

PATIENCE = 10.0
"""How long the scheduler of a cluster, and then its first worker, are waited for, in s."""


@dataclass(frozen=True)
class Workers:
    """Something that runs functions side by side, and how many at a time."""

    executor: Executor
    count: int
    local: bool
    """Whether they share our memory."""


@contextmanager
def workers(scheduler: str | None) -> Iterator[Workers]:
    """Give the cores of this machine, or the cluster of the Dask scheduler at an address.

    Kernels leave the interpreter to others, so threads are enough on one machine. Raises FlockError
    where no scheduler answers or it has no workers.
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
    from distributed import Client  # takes half a second to import

    try:
        client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise FlockError(
            f"--scheduler {scheduler}: no Dask scheduler answers there within {PATIENCE:g} s "
            f"({type(error).__name__}); give its address, such as tcp://127.0.0.1:8786"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise FlockError(
                f"--scheduler {scheduler}: has no workers, and got none within {PATIENCE:g} s; "
                f"start one with `./flock python -m distributed.cli.dask_worker {scheduler}`"
            ) from error
        yield Workers(client.get_executor(), sum(client.nthreads().values()), local=False)
