# SPDX-License-Identifier: Apache-2.0
"""Imports and kernels of the processes of a flight, loaded once for all of them."""

from __future__ import annotations

import gc
import inspect

from flock_sim.console.signals import ending_deferred
from flock_sim.launcher.fork_server import ForkServer
from flock_sim.launcher.forkable import CannotFork, check_forkable


def preload(links: bool = True) -> None:
    """Import and load what nodes use. `links`: also the kernels of links that are not plain.

    This neither initialises ROS nor starts a thread of its own.
    """
    import diagnostic_msgs.msg
    import rcl_interfaces.msg
    import rclpy
    import rosgraph_msgs.msg
    from rclpy.type_description_service import GetTypeDescription
    from rclpy.type_support import check_for_type_support

    import flock_interfaces.msg
    import flock_sim.nodes.bird_process
    import flock_sim.nodes.clock_process
    import flock_sim.nodes.recorder_process  # noqa: F401
    from flock_sim.launcher import precompile

    precompile.warm_bird()
    precompile.warm_exchange()
    if links:
        precompile.warm_links()
    rclpy.get_rmw_implementation_identifier()  # loads Fast DDS
    kinds = [
        *(kind for kind in vars(flock_interfaces.msg).values() if isinstance(kind, type)),
        diagnostic_msgs.msg.DiagnosticArray,
        rcl_interfaces.msg.ParameterEvent,
        rosgraph_msgs.msg.Clock,
        GetTypeDescription,  # a service of each node
    ]
    for kind in kinds:
        check_for_type_support(kind)
    inspect.stack()  # as rclpy does to log; the first time, it resolves the paths of all modules
    gc.collect()
    gc.freeze()  # a collection in a child then does not copy these pages


def preloaded_server(links: bool) -> ForkServer | None:
    """Return a server that forks node processes with all of this loaded; None if it can't exist.

    It is forked from this process, which loads all of this first. If this process has threads, the
    server is a new process.
    """
    with ending_deferred():
        try:
            try:
                check_forkable()
                preload(links)
                return ForkServer.fork()
            except CannotFork:
                return ForkServer.spawn(f"{__name__}:preload")
        except CannotFork:
            return None
