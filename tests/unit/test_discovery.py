# SPDX-License-Identifier: Apache-2.0
import os

import pytest

from flock_sim.discovery import own_domain, prepare_discovery
from flock_sim.errors import FlockError


def test_others_are_looked_for_on_this_machine_unless_asked_otherwise(monkeypatch):
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    prepare_discovery()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    prepare_discovery()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


@pytest.mark.parametrize("domain", ["abc", "-1", "233", "1.5", "²"])
def test_a_domain_that_ros_does_not_have_is_refused(monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(FlockError, match=r"ROS_DOMAIN_ID = .*0\.\.232"):
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


def test_a_domain_that_is_taken_is_refused_and_free_again_afterwards(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "231")
    with own_domain(), pytest.raises(FlockError, match="231: another flight"), own_domain():
        pass
    with own_domain():
        pass
