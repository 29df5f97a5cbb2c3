"""Keys: files that only their owner reads, a list of who is let in, and nothing secret anywhere else."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
import zmq

from acquire.contract.config.load import load_config
from acquire.contract.errors import ConfigError
from acquire.remote.addresses import parse_address
from acquire.remote.keys import Allowed, allow, load_allowed, load_pair, make_pair, revoke, rig_folder
from tui.cli import run

KEY = "rq:rM>}U?@Lns47E1%kR.o@n%FcmmsL/@{H8]yf7"


def load(path: Path):
    return load_pair(path, "the key", "make it")


def test_a_pair_is_kept_for_its_owner_only_and_read_back(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        made = make_pair(tmp_path / "new/own.key")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new/own.key").stat().st_mode) == 0o600
    assert load(tmp_path / "new/own.key") == made


def test_a_pair_that_is_there_is_replaced_only_by_force(tmp_path: Path) -> None:
    first = make_pair(tmp_path / "own.key")
    with pytest.raises(ConfigError, match="--force"):
        make_pair(tmp_path / "own.key")
    assert load(tmp_path / "own.key") == first
    assert make_pair(tmp_path / "own.key", force=True) != first


def test_a_secret_that_others_can_read_is_refused(tmp_path: Path) -> None:
    make_pair(tmp_path / "own.key")
    (tmp_path / "own.key").chmod(0o640)
    with pytest.raises(ConfigError, match="chmod 600"):
        load(tmp_path / "own.key")


@pytest.mark.parametrize("text", ["", "public = 1", 'public = "short"\nsecret = "short"', "\x00"])
def test_a_file_that_is_no_pair_is_refused_without_showing_it(tmp_path: Path, text: str) -> None:
    (tmp_path / "own.key").write_text(text)
    (tmp_path / "own.key").chmod(0o600)
    with pytest.raises(ConfigError, match="make it") as refusal:
        load(tmp_path / "own.key")
    assert "short" not in str(refusal.value)


def test_a_printed_pair_keeps_its_secret(tmp_path: Path) -> None:
    pair = make_pair(tmp_path / "own.key")
    assert pair.secret not in f"{pair} {pair!r}"


def test_who_is_allowed_may_steer_or_watch_until_revoked(tmp_path: Path) -> None:
    allow(tmp_path, "ann", KEY, "steer")
    allow(tmp_path, "bob", KEY[::-1], "watch")
    assert load_allowed(tmp_path) == {"ann": Allowed(KEY, "steer"), "bob": Allowed(KEY[::-1], "watch")}
    revoke(tmp_path, "ann")
    assert set(load_allowed(tmp_path)) == {"bob"}


def test_without_a_list_nobody_is_let_in(tmp_path: Path) -> None:
    assert load_allowed(tmp_path) == {}


@pytest.mark.parametrize("text", ["[ann]\nmay = 'steer'", "[ann]\nkey = 'k'\nmay = 'rule'", "ann = 1", "= ="])
def test_a_list_that_cannot_be_read_is_an_error_and_not_a_guess(tmp_path: Path, text: str) -> None:
    (tmp_path / "allowed.toml").write_text(text)
    with pytest.raises(ConfigError, match="nobody is let in"):
        load_allowed(tmp_path)


@pytest.mark.parametrize(("name", "key"), [("a b", KEY), ("../x", KEY), ("", KEY), ("ann", "too short"), ("ann", "")])
def test_what_is_no_name_or_no_key_is_not_written(tmp_path: Path, name: str, key: str) -> None:
    with pytest.raises(ConfigError):
        allow(tmp_path, name, key, "steer")
    assert list(tmp_path.iterdir()) == []


def test_somebody_who_was_never_allowed_cannot_be_revoked(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no key is allowed"):
        revoke(tmp_path, "ann")


@pytest.mark.parametrize(
    "text", ["rig:5570", "tcp://rig", "tcp://rig:0", "tcp://rig:65534", "ipc:///x", "tcp://a:b:1", "tcp://:1"]
)
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="tcp://HOST:PORT"):
        parse_address(text)


def test_the_lanes_stand_on_consecutive_ports_also_in_ipv6() -> None:
    assert parse_address("tcp://rig:5570").endpoint("command") == "tcp://rig:5573"
    assert parse_address("tcp://[::1]:5570").endpoint("status") == "tcp://[::1]:5570"


def test_the_rigs_keys_lie_where_the_configuration_says(tmp_path: Path) -> None:
    loaded = load_config(environ={"SWEEPSCOPE_NETWORK__KEYS_DIR": str(tmp_path)})
    assert rig_folder(loaded) == tmp_path


def test_a_public_key_is_never_taken_for_an_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = iter([(b"-" + KEY[1:].encode(), KEY.encode()), (KEY.encode(), KEY.encode())])
    monkeypatch.setattr(zmq, "curve_keypair", lambda: next(pairs))
    assert make_pair(tmp_path / "own.key").public == KEY


@pytest.fixture
def at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home of its own for the commands."""
    for name in ("SWEEPSCOPE_CONFIG", "SWEEPSCOPE_CONNECT", "SWEEPSCOPE_SERVER_KEY", "SWEEPSCOPE_KEY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "sweepscope/keys"


def test_the_commands_make_show_and_never_tell_the_secret(at_home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (("make",), ("make", "--server"), ("allow", "ann", KEY), ("list",), ("list", "--json")):
        assert run(["keys", *words]) == 0
    said = capsys.readouterr()
    assert load(at_home / "own.key").public in said.out
    assert KEY in said.out
    for name in ("own.key", "server.key"):
        assert load(at_home / name).secret not in said.out + said.err
    assert run(["keys", "revoke", "ann"]) == 0
    assert load_allowed(at_home) == {}


def test_a_rig_far_away_needs_a_key_of_ones_own(at_home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["status", "--connect", "tcp://127.0.0.1:9", "--server-key", KEY]) == 1
    assert "keys make" in capsys.readouterr().err
    assert run(["status", "--connect", "tcp://127.0.0.1:9"]) == 1
    assert "--server-key" in capsys.readouterr().err


def test_a_gateway_without_an_address_says_what_to_set(at_home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["gateway", "--configured"]) == 1
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SWEEPSCOPE_NETWORK__HOST", "127.0.0.1")
        assert run(["gateway", "--configured"]) == 0
