"""Subcommands on scan files: import, reconstruct, page, verify, info, recover. They need no service."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from acquire.contract.errors import EXIT_FAILED, EXIT_INCOMPLETE, ScanFileError
from tui.commands.context import PATH, TEXT, Number, Session, json_option, print_json, progress_option, progress_printer

if TYPE_CHECKING:
    from process.results.reconstruct import Summary

_SCAN = click.argument("scan", type=PATH)


@click.command("import")
@click.argument("frames_dir", type=PATH)
@click.argument("target", metavar="SCAN.h5", type=PATH)
@click.option("--force", is_flag=True, help="Replace an existing SCAN.h5.")
@click.option("--um-per-frame", type=Number(-1e6, 1e6), help="Travel of the stage per frame, where known.")
@click.option(
    "--pattern", type=TEXT, metavar="GLOB", default="", help="Take the pictures of these names only: 'left_*.png'."
)
@click.option("--missing-as-missing", is_flag=True, help="Keep the places of missing or unreadable pictures empty.")
@click.option("--as-is", is_flag=True, help="Take what is there in natural order, without proof.")
@click.option("--bit-depth", type=click.IntRange(8, 16), help="Bits used of 16-bit pictures [by their values].")
@progress_option
@json_option
def import_(
    frames_dir: Path,
    target: Path,
    force: bool,
    um_per_frame: float | None,
    pattern: str,
    missing_as_missing: bool,
    as_is: bool,
    bit_depth: int | None,
    with_progress: bool,
    as_json: bool,
) -> int:
    """Make a scan file from a folder of pictures, or from a TIFF stack.

    The pictures (png, bmp, jpg, tif) must be one sequence: names that differ in one number, which counts without gaps
    in equal steps; one size and type; camera times in the same order. Else the folder is refused, with everything that
    speaks against it. Pictures that are the same are said. Names, sizes and checksums of the files are kept in the
    scan. A projector.txt of the original program in the folder gives the travel per frame."""
    from acquire.importing.folder import import_folder
    from acquire.pictures.sequence import Asked

    if as_is and missing_as_missing:
        raise click.UsageError("--as-is does not know what is missing: give it or --missing-as-missing")
    summary = import_folder(
        frames_dir,
        target,
        force=force,
        um_per_frame=um_per_frame,
        asked=Asked(pattern, missing_as_missing, as_is, bit_depth),
        progress=progress_printer(with_progress),
    )
    print_json(summary) if as_json else click.echo(summary.words())
    return 0 if summary.complete else EXIT_INCOMPLETE


@click.command()
@_SCAN
@click.option("--calibration", type=PATH, help="calibration.json; without one: maps, no cloud.")
@click.option("--contrast", type=click.IntRange(0, 255), help="Least brightness range used, in counts of 8 bit [70].")
@click.option("--edge", type=click.Choice(["rising", "falling"]), help="Which way pixels change [the calibration's].")
@click.option("--median", type=click.IntRange(0, 31), help="Side of the median on the mask, odd; 0 for none [5].")
@click.option("--method", type=click.Choice(["linear", "probit", "fit", "auto"]), help="Crossing estimate [auto].")
@click.option("--out", type=PATH, help="Folder for maps.h5, cloud.ply, report.json.")
@click.option("--force", is_flag=True, help="Continue where options and calibration contradict.")
@progress_option
@json_option
def reconstruct(scan: Path, as_json: bool, with_progress: bool, **options: object) -> int:
    """Turn a scan into maps and a coloured point cloud.

    Without a single point (or crossing, where there is no light plane) the status is 1, and the reason is said."""
    from process.calibration.light_plane.refit import with_matching_plane
    from process.results.reconstruct import reconstruct as run
    from process.results.settings import ReconstructOptions

    asked = ReconstructOptions(**options)  # type: ignore[arg-type]
    matched = with_matching_plane(scan, asked, lambda text: click.echo(text, err=True))
    summary = run(scan, matched, progress_printer(with_progress))
    _show_json(summary) if as_json else _show_words(summary)
    if summary.nothing:
        click.echo(f"sweepscope: {summary.nothing}", err=True)
        return EXIT_FAILED
    return 0 if summary.complete else EXIT_INCOMPLETE


@click.command()
@_SCAN
@click.option("--results", type=PATH, help="Folder of maps.h5 and report.json [next to the .h5].")
@click.option("--out", type=PATH, help="File to write [report.html next to the results].")
def page(scan: Path, results: Path | None, out: Path | None) -> None:
    """Show a scan and its results on one HTML page.

    It opens in any browser, without a network."""
    from process.results.page.html import assess, write_page
    from process.results.page.load import read_results

    found = read_results(scan, results)
    target = out or (results or found.layout.path.parent) / "report.html"
    write_page(target, found)
    click.echo(f"{assess(found).headline}\n{target}")


def _show_json(summary: Summary) -> None:
    import msgspec

    facts = {name: getattr(summary, name) for name in ("scan", "complete", "outcome", "points", "warnings")}
    paths = {"maps": summary.paths.maps, "cloud": summary.paths.cloud, "report": summary.paths.report}
    if summary.points is None:
        paths.pop("cloud")
    print_json({**facts, "paths": paths, "report": msgspec.to_builtins(summary.results.report)})


def _show_words(summary: Summary) -> None:
    report, paths = summary.results.report, summary.paths
    click.echo(f"{summary.outcome_text}  {summary.scan}")
    counts, seconds = report.counts, sum(report.timings_s.values())
    click.echo(
        f"{counts['over_contrast']} pixels over the contrast, {counts['past_s_in_first']} past S in the first frame, "
        f"{counts['crossings']} crossings, {'no cloud' if summary.points is None else f'{summary.points} points'}, "
        f"in {seconds:.2f} s"
    )
    for path in (paths.maps, paths.cloud if summary.points is not None else None, paths.report):
        if path is not None:
            click.echo(str(path))
    for warning in summary.warnings if not summary.nothing else summary.warnings[1:]:
        click.echo(f"note: {warning}", err=True)
    for note in summary.notes:
        click.echo(f"note: {note}", err=True)


@click.command()
@_SCAN
@progress_option
@json_option
def verify(scan: Path, as_json: bool, with_progress: bool) -> int:
    """Read a whole scan and check every frame."""
    from acquire.writer.verify import verify as run

    report = run(scan, progress_printer(with_progress))
    print_json(report.as_dict()) if as_json else click.echo("\n".join(report.words()))
    if not report.ok:
        return EXIT_FAILED
    return 0 if report.complete else EXIT_INCOMPLETE


@click.command()
@_SCAN
@click.option(
    "--sources", is_flag=True, help="Print the picture files of an imported scan, as sha256sum --check reads."
)
@json_option
def info(scan: Path, sources: bool, as_json: bool) -> None:
    """Show what a scan contains."""
    from acquire.writer.verify import info as run

    facts = run(scan)
    if sources:
        if facts.sources is None:
            raise ScanFileError(f"{scan} does not tell which pictures it was made of: no import, or an older one")
        click.echo(b"\n".join(facts.sources.checksum_lines()))
        return
    print_json(facts) if as_json else click.echo("\n".join(facts.words()))


@click.command()
@click.argument("where", metavar="[DIR]", type=PATH, required=False)
@click.option("--seal", is_flag=True, help="Seal interrupted scans: they can no longer be resumed.")
@click.option("--compact", is_flag=True, help="Free the space that sealed scans reserved and do not need.")
@click.option("--begun", is_flag=True, help="Only scans whose writer died since the last check: quick, for each start.")
@json_option
@click.pass_obj
def recover(session: Session, where: Path | None, seal: bool, compact: bool, begun: bool, as_json: bool) -> int:
    """Verify interrupted scans.

    DIR is a folder of scans [storage.data_dir] or one scan. Every committed frame is verified, and the scan is marked
    as interrupted, so that it can be resumed. A running sweep is never touched."""
    from acquire.writer.recover import RecoverOptions
    from acquire.writer.recover import recover as run

    if where is not None and not where.exists():
        raise ScanFileError(f"{where} does not exist: give a folder of scans, or one scan")
    unreadable, facts = False, []
    for found in run(where or session.config().data_dir, RecoverOptions(seal, compact, begun_only=begun)):
        unreadable |= found.state == "unreadable"
        facts.append(found)
        if not as_json:
            click.echo(found.words())
    if as_json:
        print_json({"scans": facts})
    elif not facts:
        click.echo("there is nothing to recover")
    return EXIT_FAILED if unreadable else 0


COMMANDS: tuple[click.Command, ...] = (import_, reconstruct, page, verify, info, recover)
