"""These tests need vcan0, and vxcan0 joined to vxcan1: `python -m tests.socketcan.guest` makes them."""

from __future__ import annotations

import socket

THERE = {name for _, name in socket.if_nameindex()}
collect_ignore_glob = [] if {"vcan0", "vxcan0", "vxcan1"} <= THERE else ["test_*.py"]
