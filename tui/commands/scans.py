"""Subcommands on the folder of scans: scans, notes, copy, trash. A scan that is being written is never touched."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tui.commands.context import PATH, TEXT, Session, json_option, print_json, progress_option, progress_printer

if TYPE_CHECKING:
    from tui.scans.folder import ScanEntry

_SCAN = click.argument("scan", type=PATH)


@click.command()
@click.argument("where", metavar="[DIR]", type=PATH, required=False)
@json_option
@click.pass_obj
def scans(session: Session, where: Path | None, as_json: bool) -> None:
    """List the scans in DIR [storage.data_dir], the newest first."""
    from acquire.contract.errors import ScanFileError
    from tui.scans.folder import ScanFolder

    if where is not None and not where.is_dir():
        raise ScanFileError(f"{where} is not a folder: give a folder of scans")
    folder = where or session.config().data_dir
    found = ScanFolder(folder).look()
    if as_json:
        print_json({"folder": folder, "scans": found})
        return
    for line in _table(found):
        click.echo(line)
    if not found:
        click.echo(f"no scans in {folder}")


def _table(found: list[ScanEntry]) -> list[str]:
    from datetime import UTC, datetime

    from acquire.contract.units import format_bytes

    now = datetime.now(UTC)
    rows = [
        (
            entry.folder.name,
            entry.outcome_words,
            format_bytes(entry.size_bytes),
            "-" if entry.points is None else f"{entry.points} points",
            entry.age_words(now),
            "copied" if entry.copies else "",
        )
        for entry in found
    ]
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(6)]
    return ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


@click.command()
@_SCAN
@click.option("--name", type=TEXT, help="Name of the scan; its folder keeps its name.")
@click.option("--specimen", type=TEXT, help="Name of the specimen.")
@click.option("--operator", type=TEXT, help="Name of the operator.")
@click.option("--notes", type=TEXT, help="Free text.")
@click.option("--tag", "tags", type=TEXT, multiple=True, help="May be given more than once; replaces all tags.")
@json_option
def notes(scan: Path, as_json: bool, **wanted: Any) -> None:
    """Show or edit the notes of a scan.

    The scan itself is never changed: notes go into notes.json next to it."""
    import msgspec

    from acquire.contract.scan_data.file_layout import read_layout
    from acquire.contract.scan_data.notes import notes_of, write_notes
    from tui.scans.folder import held, scan_folder

    folder = scan_folder(scan)
    found = notes_of(folder, read_layout(folder).user)
    changes = {name: value for name, value in wanted.items() if value not in (None, ())}
    if changes:
        with held(folder):
            found = write_notes(folder, msgspec.structs.replace(found, **changes))
    if as_json:
        print_json({"scan": folder, **msgspec.to_builtins(found)})
        return
    for name, value in msgspec.to_builtins(found).items():
        if value:
            click.echo(f"{name}: {', '.join(value) if isinstance(value, list | tuple) else value}")


@click.command()
@_SCAN
@click.argument("dest", type=PATH)
@progress_option
@json_option
def copy(scan: Path, dest: Path, with_progress: bool, as_json: bool) -> None:
    """Copy a scan into the folder DEST and verify it there.

    Every file is read back from the other disk and compared by its sha256; the scan is marked as copied, and the copy
    holds SHA256SUMS for 'sha256sum -c'."""
    from tui.scans.copies import copy_scan
    from tui.scans.folder import held, scan_folder

    folder = scan_folder(scan)
    with held(folder):
        made = copy_scan(folder, dest, progress_printer(with_progress))
    print_json(made) if as_json else click.echo(made.words())


@click.command()
@_SCAN
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_obj
def trash(session: Session, scan: Path, yes: bool, as_json: bool) -> None:
    """Move a scan to the folder .trash next to the scans.

    Nothing is deleted: empty that folder by hand to free the space."""
    from tui.scans.folder import scan_folder
    from tui.scans.trash import trash_scan

    folder = scan_folder(scan)
    if not yes:
        click.confirm(f"move {folder.name} to the trash folder?", abort=True, err=True)
    now = trash_scan(folder, session.config().data_dir)
    print_json({"scan": folder, "now": now}) if as_json else click.echo(f"{folder.name} is in {now} now")


COMMANDS: tuple[click.Command, ...] = (scans, notes, copy, trash)
