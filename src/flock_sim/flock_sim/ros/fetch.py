# SPDX-License-Identifier: Apache-2.0
"""Topics whose messages listeners in other processes fetch in batches.

By default Fast DDS sends each message to every listener when it is published. This costs the bird a
system call, wakes the listener, and needs an acknowledgement. If no process waits for the message,
this cost is not justified. In pull mode a writer announces its messages from time to time. A
listener requests those that it lacks, and gets them in one batch from another thread of the writer.

Listeners in the same process still get each message at once, but no fetched topic may have any: if
it has one, Fast DDS 2.14 does not announce a message that is published after a pause.

A profile of a topic replaces the default one, so it repeats what our settings say (`machine.xml`):
messages carry no announcements, and start no timer. By default each message carries an announcement
once the queue of its writer is full, and each listener answers it.

The mode is a property of a profile, and rmw_fastrtps uses the profile with the name of the topic.
ROS has no function to load profiles of single topics, so that of Fast DDS is called by its name in
the library. If the library lacks that name, messages are sent by default.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable

from flock_sim.ros.discovery import our_settings
from flock_sim.ros.fastdds_shutdown import GET_FACTORY, fast_dds

LOAD = "_ZN8eprosima7fastdds3dds24DomainParticipantFactory24load_XML_profiles_stringEPKcm"

_PROFILES = """\
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>{}</profiles></dds>"""

_PROFILE = """
<data_writer profile_name="{topic}">
  <times>
    <heartbeatPeriod><sec>{sec}</sec><nanosec>{nanosec}</nanosec></heartbeatPeriod>
    <nackSupressionDuration><nanosec>10000000</nanosec></nackSupressionDuration>
  </times>
  <qos><disable_heartbeat_piggyback>true</disable_heartbeat_piggyback></qos>
  <propertiesPolicy><properties>
    <property><name>fastdds.push_mode</name><value>false</value></property>
  </properties></propertiesPolicy>
</data_writer>"""

_known: set[str] = set()
"""The topics that already have a profile in this process: Fast DDS loads each only once."""


def let_fetch(topics: Iterable[str], period: float) -> bool:
    """Make later publishers of this process on `topics` announce messages every `period` s.

    Nothing changes if `period` is 0, or if the settings of Fast DDS are not from us. Returns
    whether `topics` have such profiles.
    """
    library = fast_dds()
    if not period or library is None or not hasattr(library, LOAD) or not our_settings():
        return False
    new = [topic for topic in topics if topic not in _known]
    if not new:
        return True
    _known.update(new)
    sec, nanosec = divmod(round(1e9 * period), 10**9)
    profiles = (_PROFILE.format(topic=topic, sec=sec, nanosec=nanosec) for topic in new)
    text = _PROFILES.format("".join(profiles))
    factory = library[GET_FACTORY]
    factory.restype = ctypes.c_void_p
    load = library[LOAD]
    load.argtypes, load.restype = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t), ctypes.c_uint
    data = text.encode()
    return bool(load(factory(), data, len(data)) == 0)
