"""viser where only the front door finds it."""

from __future__ import annotations

import secrets

import viser


def hidden_server() -> viser.ViserServer:
    """On one of this computer's sixteen million addresses of its own, drawn anew each time: a page in somebody's
    browser, which may knock at any port, has to find it first. Its tunnel to the internet is taken away."""
    host = ".".join(str(part) for part in (127, *(1 + secrets.randbelow(254) for _ in range(3))))
    server = viser.ViserServer(host=host, port=0, verbose=False)
    server.request_share_url = lambda verbose=True: None  # Any client could ask for it.
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    server.gui.main_panel.dock_right()
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(None)  # Half of the time of a picture where no GPU draws it.
    return server
