"""Whose controller_manager the trajectory node heeds where several say the same on one topic."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus

from spacearm_ident.nodes import trajectory_controller
from spacearm_ident.nodes.trajectory_controller import STATUS_AGE_S, UNKNOWN, ControllerSource

BARE = "controller_manager"


class Graph:
    """Publishers of `/diagnostics` by full name, the trajectory node among them, and a clock."""

    def __init__(self, monkeypatch, namespace: str = "/right") -> None:
        self.namespace, self.nodes, self.now = namespace, ["/right/trajectory"], 100.0
        monkeypatch.setattr(trajectory_controller, "time", SimpleNamespace(monotonic=lambda: self.now))

    def get_fully_qualified_name(self) -> str:
        return f"{self.namespace.rstrip('/')}/trajectory"

    def get_namespace(self) -> str:
        return self.namespace

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def get_publishers_info_by_topic(self, topic: str) -> list:
        assert topic == "/diagnostics"
        split = (name.rpartition("/") for name in self.nodes)
        return [SimpleNamespace(node_namespace=place or "/", node_name=name) for place, _, name in split]


@pytest.fixture
def graph(monkeypatch) -> Graph:
    return Graph(monkeypatch)


def source(graph: Graph, manager: str = BARE) -> ControllerSource:
    return ControllerSource(graph, "arm_controller", manager)


def say(source: ControllerSource, state: str, sender: str = BARE, key: str = "arm_controller") -> None:
    source.hear(DiagnosticStatus(name=f"{sender}: Controllers Activity"), {key: state})


@pytest.mark.parametrize("key", ["arm_controller", "arm_controller.state"])
@pytest.mark.parametrize("manager", ["/right/controller_manager", "/controller_manager"])
def test_the_only_manager_of_the_namespace_or_around_it_is_heeded(graph, manager, key):
    graph.nodes += [manager, "/left/identifier"]
    own = source(graph)
    assert own.enabled is None and "no status 'controller_manager: Controllers Activity'" in own.refusal
    say(own, "active", key=key)
    assert own.enabled is True
    say(own, "inactive", key=key)
    assert own.enabled is False and own.loss == "the controller arm_controller is no longer active (inactive)"
    assert "is inactive; activate it" in own.refusal
    graph.now += STATUS_AGE_S + 0.1
    assert own.enabled is None


def test_the_manager_of_another_namespace_is_not_heeded_until_it_is_named(graph):
    graph.nodes += ["/left/controller_manager"]
    own, told = source(graph), source(graph, "/left/controller_manager")
    for state, enabled in (("active", True), ("inactive", False)):
        for each in (own, told):
            say(each, state)
        assert own.enabled is None and told.enabled is enabled
    assert "is that of /left/controller_manager" in own.refusal
    assert "give its full name as the parameter controller_manager" in own.refusal


def test_two_managers_that_cannot_be_told_apart_refuse_a_run_though_both_say_active(graph):
    graph.nodes += ["/left/controller_manager", "/right/controller_manager"]
    own = source(graph)
    say(own, "active"), say(own, "active")
    assert own.enabled is None
    assert "may be that of /left/controller_manager, /right/controller_manager" in own.refusal
    assert "diagnostic_updater.use_fqn" in own.refusal and "-r /diagnostics:=" in own.refusal


def test_a_second_manager_that_comes_up_ends_no_run_until_one_of_them_says_inactive(graph):
    graph.nodes += ["/right/controller_manager"]
    own = source(graph)
    say(own, "active")
    graph.nodes += ["/left/controller_manager"]
    say(own, "active")
    assert own.enabled is not False
    # It may be the own one: without its controller the arm is not led on.
    say(own, "inactive")
    assert own.enabled is False and "no longer active (inactive); " in own.loss and "/left/" in own.loss


def test_statuses_with_the_namespace_in_their_name_are_told_apart(graph):
    graph.nodes += ["/left/controller_manager", "/right/controller_manager"]
    own = source(graph)
    say(own, "inactive", "/left/controller_manager")
    assert own.enabled is None
    say(own, "active", "/right/controller_manager"), say(own, "inactive", "/left/controller_manager")
    assert own.enabled is True
    say(own, "inactive", "/right/controller_manager"), say(own, "active", "/left/controller_manager")
    assert own.enabled is False


def test_one_manager_with_and_one_without_its_namespace_in_the_name_are_told_apart(graph):
    graph.nodes += ["/left/controller_manager", "/right/controller_manager"]
    own = source(graph)
    say(own, "inactive", "/left/controller_manager"), say(own, "active")
    assert own.enabled is True


def test_two_managers_of_one_full_name_are_found_by_their_contradiction(graph):
    graph.nodes += ["/right/controller_manager", "/right/controller_manager"]
    own = source(graph)
    say(own, "active"), say(own, "inactive")
    assert own.enabled is False
    say(own, "active")
    assert own.enabled is None and "active and inactive by turns" in own.refusal
    # A controller that somebody switched off and on again is the same a while later.
    graph.now += STATUS_AGE_S + 0.1
    say(own, "active")
    assert own.enabled is True


def test_a_status_that_came_by_way_of_another_node_counts_where_all_are_of_this_arm(graph):
    graph.nodes += ["/right/relay"]
    own = source(graph)
    say(own, "active")
    assert own.enabled is True
    graph.nodes += ["/left/relay"]
    assert own.enabled is None and "may be that of /left/relay, /right/relay" in own.refusal


def test_a_publisher_whose_node_is_not_known_yet_is_nobodys(graph):
    graph.nodes += ["/right/controller_manager", f"/_NODE_NAMESPACE_UNKNOWN_/{UNKNOWN}"]
    own = source(graph)
    say(own, "active")
    assert own.enabled is None


def test_outside_any_namespace_only_the_manager_outside_any_is_heeded(monkeypatch):
    graph = Graph(monkeypatch, "/")
    graph.nodes += ["/controller_manager"]
    own = source(graph)
    say(own, "active")
    assert own.enabled is True
    graph.nodes[-1] = "/left/controller_manager"
    assert own.enabled is None and "start both in one namespace" in own.refusal
