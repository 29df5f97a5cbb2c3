"""Cases: a command line, its surroundings, and how it is run; the same seed makes the same cases."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass, field

import click

from tests.fuzz.corpus import BAD_BYTE, CONFIGS, Corpus
from tui.cli import cli

STREAMS = ("pipe", "pipe", "pipe", "pipe", "terminal", "dumb", "closed", "full", "reader gone")
ENCODINGS = ("utf-8", "utf-8", "iso8859-1", "ascii", "cp1252", "koi8-r")
SERVICES = frozenset(
    {"daemon", "writer", "worker", "viewer", "up", "demo", "console", "gateway", "watch", "-f", "--follow"}
)
"""Commands that run until they are told to end."""
CHANGES_MACHINE = frozenset({"install", "uninstall"})
"""Run with --dry-run only."""

BAD_NUMBERS = (
    *("nan", "inf", "-inf", "-0", "1e300", "-1e300", "0x10", "1_000", "9" * 40, "9" * 5000, "-1", "0", "", " ", "1,5"),
    *("ten", "1e-320", "\u0661", "--5", "1.0", "true"),
)
TEXTS = (
    *(
        "stapes",
        "m\u00fc",
        "\u4e2d\u6587",
        BAD_BYTE,
        "x" * 500,
        "x" * 5000,
        "a/b",
        "../x",
        "\x1b[31mred",
        "",
        " ",
        "-x",
    ),
    *("new\nline", "\u202eright", "{}", "%s", "'; rm", "tcp://127.0.0.1:1", "tcp://[::1", "8x8", "0x0", "99999x99999"),
    *("10,7", "10X7", "1.5,2.5", "gain=3", "gain=nan", "gain=", "exposure-ms=1e9", "DICT_4X4_50", "a" * 40),
)
VARIABLES: tuple[dict[str, str], ...] = (
    {},
    {},
    {},
    {"HOME": "/nonexistent"},
    {"HOME": "/proc/nowhere"},
    {"HOME": ""},
    {"XDG_CONFIG_HOME": "/proc/nowhere"},
    {"XDG_CONFIG_HOME": "/proc/nowhere/" + BAD_BYTE},
    {"XDG_RUNTIME_DIR": "/nonexistent", "SWEEPSCOPE_RUN": ""},
    {"SWEEPSCOPE_RUN": "/proc/nowhere"},
    {"SWEEPSCOPE_RUN": "/dev/null"},
    {"SWEEPSCOPE_RUN": "/tmp/" + "r" * 120},
    {"SWEEPSCOPE_RUN": "/tmp/" + BAD_BYTE},
    {"SWEEPSCOPE_CONFIG": "missing.toml"},
    {"SWEEPSCOPE_CONFIG": "nan.toml"},
    {"SWEEPSCOPE_CAMERA__GAIN": "nan"},
    {"SWEEPSCOPE_CAMERA_GAIN": "3"},
    {"SWEEPSCOPE_CAMERA__WIDTH": "9" * 9000},
    {"SWEEPSCOPE_STORAGE__DATA_DIR": BAD_BYTE},
    {"SWEEPSCOPE_STORAGE__DATA_DIR": "/proc/nowhere"},
    {"SWEEPSCOPE_STAGE__KIND": "arduino"},
    {"SWEEPSCOPE_CONNECT": "tcp://127.0.0.1:9", "SWEEPSCOPE_SERVER_KEY": "k" * 40},
    {"LOGNAME": BAD_BYTE},
    {"COLUMNS": "zero", "LINES": "-1"},
    {"NO_COLOR": "1"},
    {"TMPDIR": "/nonexistent"},
    {"TMPDIR": "/tmp/" + BAD_BYTE},
    {"LIFELINE": "x", "SWEEPSCOPE_LIFELINE_FD": "999"},
    {"NOTIFY_SOCKET": "/nonexistent"},
    {"WATCHDOG_USEC": "x", "JOURNAL_STREAM": "1:2"},
)
LOCALES: tuple[dict[str, str], ...] = (
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"LC_ALL": "POSIX", "LANG": ""},
    {"LC_ALL": "xx_YY.ISO-8859-1", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"PYTHONIOENCODING": "iso8859-1"},
    {"PYTHONIOENCODING": "ascii:strict"},
    {"PYTHONIOENCODING": "cp1252"},
)
"""They count only for an interpreter that starts with them."""


@dataclass(frozen=True)
class Case:
    """One command line and its surroundings."""

    number: int
    arguments: tuple[str, ...]
    environ: dict[str, str] = field(default_factory=dict)
    streams: str = "pipe"
    encoding: str = "utf-8"
    own_interpreter: bool = False
    """Run by a new interpreter, not by a fork."""
    live: bool = False
    """Asks a daemon that runs."""

    @property
    def is_service(self) -> bool:
        """It may run until it is told to end."""
        return bool(SERVICES.intersection(self.arguments)) and "--help" not in self.arguments


def commands(group: click.Group = cli, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every subcommand with its words."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, (*before, name))
            if not command.invoke_without_command:
                continue
        yield (*before, name), command


def make_cases(count: int, seed: int, corpus: Corpus) -> list[Case]:
    """``count`` cases: each subcommand in turn, with everything else by chance."""
    source = random.Random(seed)
    known = sorted(commands(), key=lambda pair: pair[0])
    source.shuffle(known)
    return [_case(number, source, *known[number % len(known)], corpus) for number in range(count)]


def _case(number: int, source: random.Random, words: tuple[str, ...], command: click.Command, corpus: Corpus) -> Case:
    arguments = [*words, *_values(source, command, corpus)]
    if CHANGES_MACHINE.intersection(words):
        arguments.insert(1, "--dry-run")
    elif source.random() < 0.05:
        arguments.insert(source.randrange(len(arguments) + 1), source.choice(("--frobnicate", BAD_BYTE, "", "--help")))
    if source.random() < 0.35:
        config = source.choice((*CONFIGS, *corpus.files))
        arguments = ["--config", config, *arguments]
    own = source.random() < 0.12
    environ = dict(source.choice(VARIABLES)) | (source.choice(LOCALES) if own else {})
    live = not SERVICES.intersection(words) and source.random() < 0.5
    return Case(number, tuple(arguments), environ, source.choice(STREAMS), source.choice(ENCODINGS), own, live)


def _values(source: random.Random, command: click.Command, corpus: Corpus) -> Iterator[str]:
    for parameter in command.params:
        if isinstance(parameter, click.Argument):
            if parameter.required or source.random() < 0.7:
                yield _value(source, parameter, corpus)
        elif isinstance(parameter, click.Option) and parameter.opts[0] != "--help":
            often = 0.9 if parameter.required else 0.25
            if source.random() < often:
                yield source.choice(parameter.opts)
                if not parameter.is_flag:
                    yield _value(source, parameter, corpus)


def _value(source: random.Random, parameter: click.Parameter, corpus: Corpus) -> str:
    kind, good = parameter.type, source.random() < 0.6
    if isinstance(kind, click.Choice):
        return str(source.choice(kind.choices)) if good else source.choice(TEXTS)
    if isinstance(kind, click.IntRange | click.FloatRange):
        low, high = (kind.min or 0) + kind.min_open, kind.max if kind.max is not None else 100
        value = source.uniform(low, high)
        return (
            f"{value:.0f}" if isinstance(kind, click.IntRange) else f"{value:g}" if good else source.choice(BAD_NUMBERS)
        )
    if kind in (click.INT, click.FLOAT):
        return str(source.randrange(-5, 50)) if good else source.choice(BAD_NUMBERS)
    if isinstance(kind, click.Path):
        return _path(source, str(parameter.name), corpus) if good else source.choice(corpus.paths)
    return source.choice((*TEXTS, *BAD_NUMBERS, *corpus.paths))


def _path(source: random.Random, name: str, corpus: Corpus) -> str:
    if name in ("frames_dir", "folder", "views", "images"):
        return source.choice(corpus.folders)
    if name in ("calibration", "camera"):
        return source.choice(corpus.calibrations)
    if name in ("target", "out", "dest"):
        return source.choice(("new", "new.h5", "empty", "good", "made/new.json"))
    return source.choice(corpus.scans)
