"""The command `sweepscope`: collects the subcommands, prints every error on one line, sets the exit status."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import traceback
from collections.abc import Sequence

import click

from acquire.contract.errors import EXIT_FAILED, EXIT_USAGE, SweepscopeError
from tui.commands import calibrate, devices, files, installation, remote, scans, services, stage, sweep
from tui.commands.context import Session
from tui.text.streams import prepare_streams

EXIT_INTERRUPTED = 130
"""128 + SIGINT, as shells report it."""
EXIT_NOT_READ = 141
"""128 + SIGPIPE: whoever read our output has ended."""


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option("--config", "config_path", metavar="RIG.TOML", help="Configuration file; see 'sweepscope config'.")
@click.option("--debug", is_flag=True, help="Show the traceback of an unexpected error, and log more.")
@click.pass_context
def cli(context: click.Context, config_path: str | None, debug: bool) -> None:
    """3D microscopy by a swept plane of light: run the rig, take scans, turn them into point clouds.

    Try 'sweepscope demo' first: a whole scan on a simulated rig.
    """
    context.obj = Session(config_path, debug)


for _command in (
    *services.COMMANDS,
    *sweep.COMMANDS,
    *devices.COMMANDS,
    *files.COMMANDS,
    *scans.COMMANDS,
    *calibrate.COMMANDS,
    *stage.COMMANDS,
    *installation.COMMANDS,
    *remote.COMMANDS,
):
    cli.add_command(_command)


def run(arguments: Sequence[str]) -> int:
    """Run the command line ``arguments`` (without the program's name); returns the exit status."""
    status = _run(arguments)
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # or the interpreter complains at its end
            status = status or _unexpected(error)
    return status


def _run(arguments: Sequence[str]) -> int:
    try:
        status = cli.main(args=list(arguments), prog_name="sweepscope", standalone_mode=False)
    except SweepscopeError as error:
        return _complain(str(error), error.exit_status)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return EXIT_USAGE
    except click.ClickException as error:
        return _complain(error.format_message() + _where_to_look(error), error.exit_code)
    except (click.Abort, KeyboardInterrupt, SystemExit) as error:
        return _broken_off(error)
    except Exception as error:  # noqa: BLE001 - outermost: any error is printed on one line
        if "--debug" in arguments:
            traceback.print_exc()
        return _unexpected(error)
    return status if isinstance(status, int) else 0


def _broken_off(error: BaseException) -> int:
    """Ctrl-C, a question without a yes, or nobody who reads on."""
    if isinstance(error, SystemExit):  # click's answer to a broken pipe
        return EXIT_NOT_READ
    if isinstance(error, click.Abort) and error.__cause__ is None:  # Ctrl-C is a cause, an answer is none
        return _complain("no yes: nothing was done", EXIT_INTERRUPTED)
    return EXIT_INTERRUPTED


def _complain(text: str, exit_status: int) -> int:
    with contextlib.suppress(OSError):  # nobody may be there to read it
        print("sweepscope: " + " ".join(text.split()), file=sys.stderr)
    return exit_status


def _where_to_look(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return f" (see '{context.command_path} --help')" if context is not None else ""


def _unexpected(error: Exception) -> int:
    """An error that no command explains: first those of the machine, then our own."""
    if isinstance(error, BrokenPipeError):
        return EXIT_NOT_READ
    if isinstance(error, OSError):
        where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
        return _complain(f"{where}{_machine_words(error)}: fix that, then try again", EXIT_FAILED)
    if isinstance(error, MemoryError):
        return _complain("this machine has not enough memory for that: end other programs", EXIT_FAILED)
    if isinstance(error, UnicodeEncodeError):
        return _complain(
            f"'{error.object[:80]}' cannot be written in {error.encoding} (a file name that is not UTF-8, or a locale "
            "that lacks a letter): rename it, or set PYTHONUTF8=1",
            EXIT_FAILED,
        )
    return _complain(
        f"unexpected {type(error).__name__}: {error} (a bug: 'sweepscope --debug ...' shows where)", EXIT_FAILED
    )


def _machine_words(error: OSError) -> str:
    if error.errno == errno.EMFILE:
        return "too many files are open (raise it with 'ulimit -n')"
    return error.strerror or str(error)


def main() -> None:
    """Entry point of the installed command."""
    prepare_streams()
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
