"""A serial adapter as an interface: the kernel speaks slcan to it, and the driver SocketCAN to the kernel."""

from __future__ import annotations

import fcntl
import os
import struct
import termios
from pathlib import Path

from tests.patience import comes_true
from tests.socketcan.inside.rigs import assert_recorded, command, config, exit_code, forked, hand_on, ip

_N_SLCAN, _SIOCGIFNAME = 17, 0x8910  # linux/tty.h; linux/sockios.h


def attached(port: int) -> str:
    """The interface that the kernel makes of a serial port: what `slcand` does."""
    fcntl.ioctl(port, termios.TIOCSETD, struct.pack("i", _N_SLCAN))
    return fcntl.ioctl(port, _SIOCGIFNAME, bytes(16)).rstrip(b"\0").decode()


def test_a_hand_behind_the_kernels_own_slcan_is_driven_and_limp_after_the_command(tmp_path: Path) -> None:
    tty, recording = tmp_path / "hand.tty", tmp_path / "run.arrow"
    with hand_on(str(tty)) as hand:
        port = os.open(tty, os.O_RDWR | os.O_NOCTTY)
        name = attached(port)
        ip("link", "set", name, "up", "type", "can", "bitrate", "1000000")
        with forked(command("run", config(tmp_path, name, deadman=1.0), "--seconds", 1, "--record", recording)) as run:
            assert comes_true(lambda: hand.pushes, 40.0)
            assert exit_code(run) == 0
        assert hand.seen.limp_since
        assert not hand.seen.serving
        os.close(port)
    assert_recorded(recording)
