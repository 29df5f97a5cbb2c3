"""The viewer as a process: its address, its lock, its port, its end."""

from __future__ import annotations

import socket
import stat
import threading
from pathlib import Path

import pytest

from acquire.contract.config.load import load_config
from acquire.contract.errors import AlreadyRunningError, ConfigError
from acquire.contract.process.run_dir import lock_service
from process.viewer.service import Viewer, run_viewer
from tests.fakes.processes.viewer_process import ViewerProcess


def test_the_address_is_printed_and_kept_in_a_file_for_this_user_alone_until_the_end(run_dir: Path) -> None:
    kept = run_dir / "viewer.url"
    with ViewerProcess(run_dir) as viewer:
        assert kept.read_text().strip() == viewer.url
        assert stat.S_IMODE(kept.stat().st_mode) == 0o600
        assert viewer.end() == (0, "")
    assert not kept.exists()


def test_a_taken_port_is_an_error_in_one_line_and_no_other_port_is_tried(run_dir: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=f"127.0.0.1:{port}: the port is taken.*viewer.port") as caught:
            run_viewer(load_config(), run_dir, port=port)
    assert "\n" not in str(caught.value)
    assert not (run_dir / "viewer.url").exists()


def test_a_second_viewer_leaves_with_the_pid_of_the_first(run_dir: Path) -> None:
    lock = lock_service(run_dir, "viewer")
    with pytest.raises(AlreadyRunningError, match="pid"):
        run_viewer(load_config(overrides={"viewer.port": 0}), run_dir)
    lock.release()


@pytest.mark.parametrize(("host", "controls"), [("127.0.0.1", True), ("0.0.0.0", False)])
def test_a_page_that_others_can_reach_has_nothing_to_press(run_dir: Path, host: str, controls: bool) -> None:
    config = load_config(overrides={"viewer.port": 0, "viewer.host": host})
    with Viewer(config, run_dir, threading.Event()) as viewer:
        # what a browser would be sent is nowhere public: not here, and not in viser
        sent = viewer._server._websock_server._broadcast_buffer.message_from_id.values()
        pressed = [type(message).__name__ for message in sent]
    inputs = {
        f"Gui{kind}Message" for kind in ("Button", "ButtonGroup", "Text", "Number", "Slider", "Dropdown", "Checkbox")
    }
    assert bool(inputs & set(pressed)) == controls
    assert "GuiHtmlMessage" in pressed, "the state is shown to all"
