"""No two workers of one run are on the same ROS domain, whatever they use it for."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from domains import USES, domain

from spacearm_ident.nodes.chain import DOMAINS

WORKERS = 8
"""As many as the Makefile allows."""


def test_workers_beside_each_other_share_no_domain_and_take_none_of_the_demo(monkeypatch):
    taken = []
    for worker in range(WORKERS):
        monkeypatch.setenv("PYTEST_XDIST_WORKER", f"gw{worker}")
        taken += [int(domain(use)) for use in USES]
    assert len(set(taken)) == len(taken) == WORKERS * len(USES)
    # Above 101 DDS's ports are those that Linux gives to anybody.
    assert not set(taken) & set(DOMAINS) and max(taken) <= 101
