# SPDX-License-Identifier: Apache-2.0
import os
import socket
from pathlib import Path
from xml.etree import ElementTree

import pytest

from flock_sim.errors import FlockError
from flock_sim.ros import discovery
from flock_sim.ros.discovery import (
    ELSEWHERE,
    LOCALHOST_ONLY,
    PROFILES,
    TRANSPORTS,
    check_middleware,
    held_domain,
    on_loopback_alone,
    our_settings,
    own_domain,
    prepare_discovery,
    quiet_domains,
)

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    """An environment that says nothing, and is as it was before once the test has ended."""
    ros = ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", RANGE, LOCALHOST_ONLY, *ELSEWHERE)
    for name in (*ros, *PROFILES, TRANSPORTS):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(discovery, "is_fast_dds_3", lambda: False)


@pytest.mark.parametrize(
    ("network", "said", "reach"),
    [
        (True, "", "SUBNET"),
        (False, "SUBNET", "SUBNET"),
        (True, "SUBNET", "SUBNET"),
        (True, "SYSTEM_DEFAULT", "SYSTEM_DEFAULT"),
    ],
)
def test_others_are_looked_for_on_this_machine_unless_asked_otherwise(
    monkeypatch, network, said, reach
):
    monkeypatch.setenv(RANGE, said)
    prepare_discovery(network)
    assert os.environ[RANGE] == reach
    assert told() == {"network.xml"}


def told():
    """Which of our settings Fast DDS is told."""
    return {Path(os.environ[name]).name for name in PROFILES if os.environ.get(name)}


@pytest.mark.parametrize("said", ["", "LOCALHOST"])
def test_fast_dds_is_told_to_stay_on_this_machine_as_ros_would_with_shared_memory(
    monkeypatch, said
):
    monkeypatch.setenv(RANGE, said)
    for _ in range(2):  # who is started by a tool of ours does the same once more
        prepare_discovery()
        assert os.environ[RANGE] == "SYSTEM_DEFAULT"
        assert told() == {"machine.xml"}


def test_who_is_started_by_a_tool_of_ours_may_be_asked_to_look_further():
    prepare_discovery()
    prepare_discovery(network=True)
    assert os.environ[RANGE] == "SUBNET"
    assert told() == {"network.xml"}


@pytest.mark.parametrize("name", ELSEWHERE)
def test_named_hosts_are_left_to_ros(monkeypatch, name):
    monkeypatch.setenv(name, "10.0.0.1")
    prepare_discovery()
    assert os.environ[RANGE] == "LOCALHOST"
    assert told() == {"network.xml"}


def test_another_middleware_is_told_the_range_and_nothing_else(monkeypatch):
    installed = dict.fromkeys(("rmw_cyclonedds_cpp", "rmw_fastrtps_cpp", "rmw_implementation"), "/")
    monkeypatch.setattr("ament_index_python.get_resources", lambda kind: installed)
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    prepare_discovery()
    assert os.environ[RANGE] == "LOCALHOST"
    assert {os.environ[name] for name in PROFILES} == {""}


@pytest.mark.parametrize("said", ["LOCALHOST", "OFF"])
def test_an_environment_that_is_against_the_network_is_not_overruled(monkeypatch, said):
    monkeypatch.setenv(RANGE, said)
    with pytest.raises(FlockError, match=f"{RANGE} = {said} and --network exclude each other"):
        prepare_discovery(network=True)


RENAMED = {
    "heartbeatPeriod>": "heartbeat_period>",
    "nackSupressionDuration>": "nack_supression_duration>",
}


@pytest.mark.parametrize("network", [False, True])
def test_fast_dds_2_and_3_are_told_the_same_but_for_names(monkeypatch, network):
    texts = []
    for three, name in enumerate(PROFILES):
        monkeypatch.setattr(discovery, "is_fast_dds_3", lambda three=three: bool(three))
        prepare_discovery(network)
        # The other one would be read, too, or refused.
        assert [each for each in PROFILES if os.environ.get(each)] == [name]
        assert our_settings()
        assert on_loopback_alone() is not network
        texts.append(Path(os.environ[name]).read_text(encoding="utf-8"))
        for each in (RANGE, *PROFILES):
            monkeypatch.setenv(each, "")
    of_2, of_3 = texts
    for name, name_in_3 in RENAMED.items():
        assert name in of_2
        of_2 = of_2.replace(name, name_in_3)
    assert of_3 == of_2


DDS = {"dds": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}


def all_settings():
    (file,) = filter(None, (os.environ.get(name) for name in PROFILES))
    return ElementTree.parse(file)


def settings(kind, network):
    """What Fast DDS is told of all participants, readers or writers."""
    prepare_discovery(network)
    (profile,) = all_settings().findall(f".//dds:{kind}", DDS)
    assert profile.get("is_default_profile") == "true"
    return profile


@pytest.mark.parametrize("network", [False, True])
def test_losses_are_repaired_soon(network):
    writer = settings("data_writer", network)
    period = writer.findtext("dds:times/dds:heartbeatPeriod/dds:nanosec", None, DDS)
    assert period is not None
    assert int(period) < 100e6  # Fast DDS would take 3 s


@pytest.mark.parametrize("network", [False, True])
def test_no_queue_can_be_full(network):
    (limits,) = settings("data_reader", network).findall("dds:topic/dds:resourceLimitsQos", DDS)
    assert {limit.text for limit in limits} == {"0"}  # to Fast DDS, none
    assert len(limits) == 3


@pytest.mark.parametrize("network", [False, True])
def test_a_process_announces_itself_often_at_first_and_then_every_second(network):
    config = settings("participant", network).find("dds:rtps/dds:builtin/dds:discovery_config", DDS)
    at_first = config.find("dds:initialAnnouncements", DDS)
    period = float(at_first.findtext("dds:period/dds:nanosec", None, DDS)) / 1e9
    count = int(at_first.findtext("dds:count", None, DDS))
    later = float(config.findtext("dds:leaseAnnouncement/dds:sec", None, DDS))
    assert period <= 0.1
    assert count * period > later
    assert later <= 1.0  # by default 3 s, for which a flock waits when a bird has started again


@pytest.mark.parametrize("network", [False, True])
def test_there_is_no_shared_memory(network):
    participant = settings("participant", network)
    assert participant.findtext("dds:rtps/dds:useBuiltinTransports", None, DDS) == "false"
    (used,) = participant.findall("dds:rtps/dds:userTransports/dds:transport_id", DDS)
    (described,) = all_settings().findall(".//dds:transport_descriptor", DDS)
    assert described.findtext("dds:transport_id", None, DDS) == used.text
    assert described.findtext("dds:type", None, DDS) == "UDPv4"


@pytest.mark.parametrize("name", [*PROFILES, TRANSPORTS])
@pytest.mark.parametrize("network", [False, True])
def test_what_a_user_has_told_fast_dds_stays(monkeypatch, name, network):
    monkeypatch.setenv(name, "mine")
    prepare_discovery(network)
    assert {os.environ[each] for each in PROFILES if each != name} == {""}
    assert os.environ[name] == "mine"


@pytest.mark.parametrize("asked", ["rmw_cyclonedds_cpp", "rmw_implementation", "fastrtps", "../x"])
def test_a_middleware_that_is_not_installed_is_refused_and_what_is_is_named(monkeypatch, asked):
    monkeypatch.setenv("RMW_IMPLEMENTATION", asked)
    with pytest.raises(FlockError) as refused:
        prepare_discovery()
    assert f"RMW_IMPLEMENTATION = {asked}: is not installed; unset it" in str(refused.value)
    assert str(refused.value).endswith(": rmw_fastrtps_cpp")


def test_without_an_index_ros_itself_has_to_find_its_middleware(monkeypatch):
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    check_middleware()


def test_discovery_that_is_off_is_refused_since_no_flight_could_begin(monkeypatch):
    monkeypatch.setenv(RANGE, "OFF")
    with pytest.raises(FlockError, match=f"{RANGE} = OFF: .* LOCALHOST"):
        prepare_discovery()


@pytest.mark.parametrize("reach", ["", "LOCALHOST", "SUBNET"])
def test_localhost_only_stays_on_this_machine_and_excludes_the_network(monkeypatch, reach):
    monkeypatch.setenv(LOCALHOST_ONLY, "1")
    monkeypatch.setenv(RANGE, reach)
    with pytest.raises(FlockError, match="and --network exclude each other"):
        prepare_discovery(network=True)
    monkeypatch.setenv("ROS_STATIC_PEERS", "127.0.0.1")  # which it overrules in ROS, too
    for _ in range(2):
        prepare_discovery()
        assert told() == {"machine.xml"}


@pytest.mark.parametrize("said", ["", "0"])
def test_localhost_only_that_is_not_set_says_nothing(monkeypatch, said):
    monkeypatch.setenv(LOCALHOST_ONLY, said)
    prepare_discovery(network=True)
    assert told() == {"network.xml"}


def unknown_host(host, port, *rest):
    if host in ("nonsense", "no host"):
        raise socket.gaierror
    return []


@pytest.mark.parametrize("said", ["nonsense", "127.0.0.1;nonsense", ";no host;"])
def test_static_peers_that_are_no_hosts_are_refused(monkeypatch, said):
    monkeypatch.setattr(socket, "getaddrinfo", unknown_host)
    monkeypatch.setenv("ROS_STATIC_PEERS", said)
    with pytest.raises(FlockError, match=f"ROS_STATIC_PEERS = {said}: .*not a known host"):
        prepare_discovery()


@pytest.mark.parametrize("said", ["nonsense", "nonsense:11811", "127.0.0.1:port", ";127.0.0.1:-1"])
def test_discovery_servers_that_are_no_hosts_are_refused(monkeypatch, said):
    monkeypatch.setattr(socket, "getaddrinfo", unknown_host)
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", said)
    with pytest.raises(FlockError, match="ROS_DISCOVERY_SERVER = "):
        prepare_discovery()


@pytest.mark.parametrize("said", ["127.0.0.1:11811", ";127.0.0.1", "TCPv4:[127.0.0.1]:42100"])
def test_discovery_servers_may_be_written_in_all_ways_of_fast_dds(monkeypatch, said):
    monkeypatch.setattr(socket, "getaddrinfo", unknown_host)
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", said)
    prepare_discovery()


@pytest.mark.parametrize(
    "domain", ["abc", "-1", "233", "1.5", "²", "9" * 5000, " 43", "0x10", "+5"]
)
def test_a_domain_that_ros_does_not_have_is_refused(monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(FlockError, match=r"ROS_DOMAIN_ID = .*0\.\.232"):
        prepare_discovery()


@pytest.mark.parametrize("domain", ["043", "08", "00", "0000000001"])
def test_a_domain_that_is_octal_to_some_is_refused(monkeypatch, domain):
    # To Python 043 is 43, to the library of C that reads it for ROS it is 35.
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(FlockError, match=r"ROS_DOMAIN_ID = 0.*0\.\.232.*"):
        prepare_discovery()


def test_an_unknown_discovery_range_names_the_nearest(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOSTS")
    with pytest.raises(FlockError, match="did you mean 'LOCALHOST'"):
        prepare_discovery()


def test_two_flights_get_domains_of_their_own(monkeypatch, capsys):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    with own_domain():
        first = os.environ["ROS_DOMAIN_ID"]
        monkeypatch.delenv("ROS_DOMAIN_ID")
        with own_domain():
            second = os.environ["ROS_DOMAIN_ID"]
            assert f"ROS_DOMAIN_ID={second}" in capsys.readouterr().err
    assert first != second


def test_a_domain_that_is_named_may_be_shared(monkeypatch, capsys):
    # Flights on one domain do not touch each other; who names one knows what he does.
    monkeypatch.setenv("ROS_DOMAIN_ID", "231")
    with own_domain(), own_domain():
        assert os.environ["ROS_DOMAIN_ID"] == "231"
    assert capsys.readouterr().err == "another flight uses ROS domain 231 too\n"
    with own_domain():
        pass
    assert capsys.readouterr().err == ""


def test_a_domain_is_held_by_one_at_a_time():
    both = [90, 91]
    with held_domain([90]) as first, held_domain(both) as second, held_domain(both) as third:
        assert (first, second, third) == (90, 91, None)
    with held_domain([90]) as again:
        assert again == 90


def test_domains_on_which_somebody_talks_are_passed_over():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as talk:
        domain = quiet_domains()[50]  # not one that another test takes
        talk.bind(("127.0.0.1", 7400 + 250 * domain + 240))
        quiet = quiet_domains()
    assert domain not in quiet
    assert 0 not in quiet
