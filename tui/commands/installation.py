"""Subcommands for the installation: install, uninstall, doctor, logs, report, and the effective configuration."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from acquire.contract.config.drivers import CAMERA_KINDS, STAGE_KINDS
from tui.commands.context import PATH, TEXT, Session, json_option, plain, print_json

if TYPE_CHECKING:
    from acquire.contract.messaging.messages import Status
    from tui.install.checks import DoctorFinding
    from tui.install.install import Step
    from tui.install.paths import InstallPaths

_user = click.option("--user", is_flag=True, help="For yourself only, without root.")
_dry_run = click.option("--dry-run", is_flag=True, help="Show each step and do nothing.")
_STAGES, _CAMERAS = click.Choice(STAGE_KINDS), click.Choice(CAMERA_KINDS)


@click.command()
@_user
@_dry_run
@click.option("--stage", type=_STAGES, help="Controller of the stage.")
@click.option("--port", type=TEXT, help="Serial port of the controller.")
@click.option("--camera", type=_CAMERAS, help="Camera driver.")
@click.option("--data-dir", type=PATH, help="Folder of all scans.")
@click.option("--no-start", is_flag=True, help="Install everything, but start nothing.")
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
    old ones are restored."""
    import os
    import shutil

    from tui.install.install import Installer, InstallOptions
    from tui.install.systemd import systemd_runs

    paths = _paths(user, dry_run)
    settings = _settings(paths, stage, port, camera, data_dir, ask=not dry_run)
    installer = Installer(paths, InstallOptions(_source(), settings, packages_from, start=not no_start), click.echo)
    if dry_run:
        _show_steps(installer.steps())
        return
    os.umask(0o022)  # the services run as another user, who must be able to read the program
    installer.go()
    click.echo("installed; 'sweepscope doctor' checks it")
    if not systemd_runs(user=user):
        click.echo("no systemd that could start the services is running here: 'sweepscope up' starts them by hand")
    if not user:
        click.echo("give a user access to the rig: sudo usermod -aG sweepscope NAME")
    elif not shutil.which("sweepscope"):
        click.echo(f"to find the command, put {paths.command.parent} into your PATH")


@click.command()
@_user
@_dry_run
def uninstall(user: bool, dry_run: bool) -> None:
    """Remove the services; scans and their configuration stay."""
    from tui.install.uninstall import uninstall_steps

    steps = uninstall_steps(_paths(user, dry_run), click.echo)
    if dry_run:
        _show_steps(steps)
        return
    for text, action in steps:
        click.echo(text)
        action()


def _show_steps(steps: list[Step]) -> None:
    for number, (text, _) in enumerate(steps, 1):
        click.echo(f"{number}. {text}")


def _paths(user: bool, dry_run: bool) -> InstallPaths:
    import os

    from tui.install.machine import InstallError
    from tui.install.paths import machine_paths, user_paths

    if not user and os.getuid() != 0 and not dry_run:
        raise InstallError("installing for the machine needs root: use sudo, or --user for yourself only")
    return user_paths() if user else machine_paths()


def _source() -> Path:
    from tui.install.machine import InstallError

    here = Path(__file__).resolve().parents[2]
    if not (here / "systemd/system").is_dir():
        raise InstallError(f"{here} is not a clone of the source: run 'sweepscope install' from one")
    return here


def _settings(
    paths: InstallPaths, stage: str | None, port: str | None, camera: str | None, data_dir: Path | None, *, ask: bool
) -> dict[str, dict[str, Any]]:
    """rig.toml of a first installation; asks at a terminal for what no option gives."""
    import sys

    from tui.install.checks import camera_nodes, serial_ports

    if ask and sys.stdin.isatty() and not paths.config.exists():
        ports, found = serial_ports(), camera_nodes()
        nodes = ", ".join(node for several in found.values() for node in several)
        click.echo(f"serial ports: {', '.join(ports) or 'none'}; video devices: {nodes or 'none'}")
        stage = stage or click.prompt("controller of the stage", type=_STAGES, default="uno" if ports else "simulated")
        if stage != "simulated" and port is None:
            port = click.prompt("its port", default=ports[0] if ports else "")
        default = next((kind for kind, several in found.items() if several), "simulated")
        camera = camera or click.prompt("camera", type=_CAMERAS, default=default)
        data_dir = data_dir or Path(click.prompt("folder of all scans", default=str(paths.data)))
    settings: dict[str, dict[str, Any]] = {"storage": {"data_dir": str((data_dir or paths.data).absolute())}}
    if stage:
        settings["stage"] = {"kind": stage} | ({"port": port} if port else {})
    if camera:
        settings["camera"] = {"kind": camera}
    return settings


@click.command()
@json_option
@click.pass_obj
def doctor(session: Session, as_json: bool) -> int:
    """Check machine, devices and services.

    Each problem comes with a fix."""
    findings = _findings(session)
    if as_json:
        # "mend" is the name that "fix" had; it goes with the next version (docs/compatibility.md)
        print_json({"findings": [plain(finding) | {"mend": finding.fix} for finding in findings]})
    else:
        for finding in findings:
            fix = f"\n{'':>18}-> {finding.fix}" if finding.fix else ""
            click.echo(f"{finding.level:<6}{finding.name:<12}{finding.text}{fix}")
    return 1 if any(finding.level == "wrong" for finding in findings) else 0


def _findings(session: Session) -> list[DoctorFinding]:
    from acquire.remote.keys import SERVER_KEY_NAME, load_allowed, rig_folder
    from tui.install.doctor import KeyFacts, examine

    def status() -> Status:
        with session.client() as client:
            return client.status()

    config = session.config()
    folder = rig_folder(config)
    return list(examine(config, status, KeyFacts(folder / SERVER_KEY_NAME, lambda: len(load_allowed(folder)))))


@click.command()
@click.option(
    "--service", type=click.Choice(["daemon", "writer", "worker", "viewer", "gateway"]), help="Only this service."
)
@click.option("--scan", "scan_uid", type=TEXT, metavar="UID", help="Only lines about this scan.")
@click.option("-n", "--lines", type=click.IntRange(1, 1_000_000), default=200, show_default=True)
@click.option("-f", "--follow", is_flag=True, help="Keep printing new lines.")
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
@click.argument("target", default="sweepscope-report.tar.gz", type=PATH)
@click.pass_obj
def report(session: Session, target: Path) -> None:
    """Pack a support report for a maintainer.

    Versions, configuration, the last logs and the doctor's findings go into TARGET; no picture, map or cloud does."""
    from tui.install.journal import as_text, last_logs, pack, versions, without_home

    homes: list[str] = []
    texts = {
        "versions.json": as_text(versions()),
        "rig.toml": session.config().explained(),
        "doctor.json": as_text(plain(_findings(session))),
        "logs.txt": last_logs(),
    }
    with contextlib.suppress(RuntimeError):  # no home folder is known: then no path can name it
        homes.append(str(Path.home()))
    pack(target, {name: without_home(text, homes) for name, text in texts.items()})
    click.echo(f"{target}: {', '.join(texts)}; look through it before you send it")


@click.command()
@json_option
@click.pass_obj
def config(session: Session, as_json: bool) -> None:
    """Print the effective configuration and its manual.

    Each key is printed with its description, its value, and the source of the value."""
    import msgspec

    loaded = session.config()
    if as_json:
        values = msgspec.to_builtins(loaded.rig)
        path = str(loaded.path) if loaded.path else None
        print_json({"path": path, "values": values, "origins": loaded.origins})
        return
    click.echo(f"# {loaded.path or 'no rig.toml found: defaults'}\n\n{loaded.explained()}", nl=False)


@click.command()
@json_option
def version(as_json: bool) -> None:
    """Print the versions of program, protocol and file layout."""
    from importlib.metadata import version as installed

    from acquire.contract.messaging.messages import PROTOCOL
    from acquire.contract.scan_data.dataset_names import LAYOUT_VERSION

    facts = {"program": installed("sweepscope"), "protocol": list(PROTOCOL), "layout": LAYOUT_VERSION}
    if as_json:
        print_json(facts)
        return
    major, minor = PROTOCOL
    click.echo(f"sweepscope {facts['program']} (protocol {major}.{minor}, scan file layout {LAYOUT_VERSION})")


COMMANDS: tuple[click.Command, ...] = (install, uninstall, doctor, logs, report, config, version)
