"""Subcommands that look after an installation: install, uninstall, doctor, logs, report."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tui.commands.context import Session, json_option, print_json

if TYPE_CHECKING:
    from acquire.contract.messaging.messages import Status
    from tui.install.doctor import KeyFacts
    from tui.install.paths import Places

_user = click.option("--user", is_flag=True, help="For yourself only, without root.")
_dry_run = click.option("--dry-run", is_flag=True, help="Show each step and do nothing.")


@click.command()
@_user
@_dry_run
@click.option("--stage", type=click.Choice(["simulated", "uno", "legacy"]), help="Controller of the stage.")
@click.option("--port", help="Serial port of the controller.")
@click.option("--camera", type=click.Choice(["simulated", "genicam", "uvc", "replay"]), help="Camera driver.")
@click.option("--data-dir", type=click.Path(path_type=Path), help="Folder of all scans.")
@click.option("--no-start", is_flag=True, help="Put everything in place, but start nothing.")
@click.option("--packages-from", type=click.Path(path_type=Path, exists=True), hidden=True)
def install(
    user: bool,
    dry_run: bool,
    stage: str | None,
    port: str | None,
    camera: str | None,
    data_dir: Path | None,
    no_start: bool,
    packages_from: Path | None,
) -> None:
    """Install or update the services on this machine.

    Run it from a clone of the source. An update keeps scans and configuration; if the new services do not start, the
    old ones are put back."""
    import os
    import shutil

    from tui.install.install import Installer, Wishes
    from tui.install.machine import systemd_runs

    places = _places(user, dry_run)
    settings = _settings(places, stage, port, camera, data_dir, ask=not dry_run)
    installer = Installer(places, Wishes(_source(), settings, packages_from, start=not no_start), click.echo)
    if dry_run:
        _show_steps([words for words, _ in installer.steps()])
        return
    os.umask(0o022)  # the services are another user, who must be able to read what is put there
    installer.go()
    click.echo("installed; 'sweepscope doctor' looks it over")
    if not systemd_runs(user=user):
        click.echo("no systemd that could start the services is running here: 'sweepscope up' starts them by hand")
    if not user:
        click.echo("who may use the rig: sudo usermod -aG sweepscope NAME")
    elif not shutil.which("sweepscope"):
        click.echo(f"to find the command, put {places.command.parent} into your PATH")


@click.command()
@_user
@_dry_run
def uninstall(user: bool, dry_run: bool) -> None:
    """Remove the services; scans and their configuration stay."""
    from tui.install.uninstall import uninstall_steps

    places = _places(user, dry_run)
    steps = uninstall_steps(places, click.echo)
    if dry_run:
        _show_steps([words for words, _ in steps])
        return
    for words, deed in steps:
        click.echo(words)
        deed()


def _show_steps(steps: list[str]) -> None:
    for number, words in enumerate(steps, 1):
        click.echo(f"{number}. {words}")


def _places(user: bool, dry_run: bool) -> Places:
    import os

    from tui.install.machine import InstallError
    from tui.install.paths import machine_places, user_places

    if not user and os.getuid() != 0 and not dry_run:
        raise InstallError("installing for the machine needs root: use sudo, or --user for yourself only")
    return user_places() if user else machine_places()


def _source() -> Path:
    from tui.install.machine import InstallError

    here = Path(__file__).resolve().parents[2]
    if not (here / "systemd/system").is_dir():
        raise InstallError(f"{here} is not a clone of the source: run 'sweepscope install' from one")
    return here


def _settings(
    places: Places, stage: str | None, port: str | None, camera: str | None, data_dir: Path | None, *, ask: bool
) -> dict[str, dict[str, Any]]:
    """rig.toml of a first installation; what no flag says is asked at a terminal."""
    import sys

    from tui.install.device_checks import cameras, serial_ports

    ports = serial_ports()
    if ask and sys.stdin.isatty() and not places.config.exists():
        click.echo(f"serial ports: {', '.join(ports) or 'none'}; video devices: {', '.join(cameras()) or 'none'}")
        kinds = click.Choice(["simulated", "uno", "legacy"])
        stage = stage or click.prompt("controller of the stage", type=kinds, default="uno" if ports else "simulated")
        if stage != "simulated" and port is None:
            port = click.prompt("its port", default=ports[0] if ports else "")
        drivers = click.Choice(["simulated", "genicam", "uvc", "replay"])
        camera = camera or click.prompt("camera", type=drivers, default="uvc" if cameras() else "simulated")
        data_dir = data_dir or Path(click.prompt("folder of all scans", default=str(places.data)))
    settings: dict[str, dict[str, Any]] = {"storage": {"data_dir": str((data_dir or places.data).absolute())}}
    if stage:
        settings["stage"] = {"kind": stage} | ({"port": port} if port else {})
    if camera:
        settings["camera"] = {"kind": camera}
    return settings


@click.command()
@json_option
@click.pass_obj
def doctor(session: Session, as_json: bool) -> int:
    """Check what people get wrong, and say the mend."""
    from tui.install.doctor import examine

    findings = list(examine(session.config(), lambda: _status(session), _key_facts(session)))
    if as_json:
        print_json({"findings": findings})
    for finding in () if as_json else findings:
        mend = f"\n{'':>18}-> {finding.mend}" if finding.mend else ""
        click.echo(f"{finding.level:<6}{finding.name:<12}{finding.text}{mend}")
    return 1 if any(finding.level == "wrong" for finding in findings) else 0


def _key_facts(session: Session) -> KeyFacts:
    from acquire.remote.keys import SERVER_KEY_NAME, load_allowed, rig_folder
    from tui.install.doctor import KeyFacts

    folder = rig_folder(session.config())
    return KeyFacts(folder / SERVER_KEY_NAME, lambda: len(load_allowed(folder)))


def _status(session: Session) -> Status:
    with session.client() as client:
        return client.status()


@click.command()
@click.option(
    "--service", type=click.Choice(["daemon", "writer", "worker", "viewer", "gateway"]), help="Only this service."
)
@click.option("--scan", "scan_uid", metavar="UID", help="Only what belongs to this scan.")
@click.option("-n", "--lines", type=click.IntRange(1, 1_000_000), default=200, show_default=True)
@click.option("-f", "--follow", is_flag=True, help="Go on with what comes.")
@json_option
def logs(service: str | None, scan_uid: str | None, lines: int, follow: bool, as_json: bool) -> int:
    """Show what the services logged."""
    import subprocess

    from tui.install.journal import journal_command

    command = journal_command(
        service=service or "", scan_uid=scan_uid or "", lines=lines, follow=follow, as_json=as_json
    )
    return subprocess.run(command, check=False).returncode


@click.command()
@click.argument("target", default="sweepscope-report.tar.gz", type=click.Path(path_type=Path))
@click.pass_obj
def report(session: Session, target: Path) -> None:
    """Pack what a maintainer would ask for.

    Versions, configuration, the last logs and what the doctor says go into TARGET; no picture, map or cloud does."""
    from tui.install.doctor import examine
    from tui.install.journal import as_text, last_logs, pack, versions, without_home

    config = session.config()
    from tui.commands.context import plain

    texts = {
        "versions.json": as_text(versions()),
        "rig.toml": config.explained(),
        "doctor.json": as_text(plain(list(examine(config, lambda: _status(session), _key_facts(session))))),
        "logs.txt": last_logs(),
    }
    homes = [str(Path.home())]
    pack(target, {name: without_home(text, homes) for name, text in texts.items()})
    click.echo(f"{target}: {', '.join(texts)}; look through it before you send it")


COMMANDS: tuple[click.Command, ...] = (install, uninstall, doctor, logs, report)
