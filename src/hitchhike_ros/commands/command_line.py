"""What all commands share: their help, options, exit statuses, and a clean end on bad input and Ctrl-C."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import click
import rosgraph.names

from hitchhike_ros.core.errors import HitchhikeError

_WIDTH = 100
_INTERRUPTED = 130  # as a shell says of what Ctrl-C ended

SETTINGS: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": _WIDTH}
"""Context settings of every command."""

json_option = click.option(
    "--json",
    "json_file",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    callback=lambda _context, _option, file: file and writable(file.parent) / file.name,
    help="Write the figures, with versions and seeds, as JSON.",
)
check_option = click.option("--check", is_flag=True, help="Let the exit status also say whether every bound holds.")
seed_option = click.option("--seed", metavar="N", type=int, default=0, show_default=True, help="First seed.")


def folder_option(*names: str, default: str, text: str) -> Callable[[Any], Any]:
    """An option that names a folder, which is made where it is missing and can be written to."""
    return click.option(
        *names,
        "output",
        metavar="DIR",
        type=click.Path(file_okay=False, path_type=Path),
        default=default,
        show_default=True,
        callback=lambda _context, _option, folder: writable(folder),
        help=text,
    )


def runs_option(text: str) -> Callable[[Any], Any]:
    """``--runs``."""
    return click.option("--runs", metavar="N", type=click.IntRange(min=1), default=1, show_default=True, help=text)


def help_of(docstring: str | None) -> str:
    """A module's docstring as help: paragraphs are filled, indented lines stay as they are."""
    paragraphs = (docstring or "").strip().split("\n\n")
    return "\n\n".join(f"\b\n{p}" if "\n  " in f"\n{p}" else p for p in paragraphs)


def run(command: click.Command, interrupted: str = "") -> NoReturn:
    """Run a command line; what the command returns is the exit status, None for 0.

    ROS's remappings, as ``__ns:=robot``, are left out. Exit status 1: something went wrong, and a line says what; 2:
    wrong usage; 130: after Ctrl-C or another signal that ends the program, and ``interrupted`` is said.
    """
    for ends in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ends, _interrupt)
    arguments = [a for a in sys.argv[1:] if rosgraph.names.REMAP not in a]
    try:
        status = command.main(arguments, str(command.name), standalone_mode=False)
    except click.ClickException as exc:
        exc.show()
        status = exc.exit_code
    except HitchhikeError as exc:
        print(f"{command.name}: {exc}", file=sys.stderr)
        status = 1
    except click.Abort:
        if interrupted:
            print(interrupted, file=sys.stderr)
        status = _INTERRUPTED
    sys.exit(status)


def _interrupt(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def writable(folder: Path) -> Path:
    """The folder, made where it is missing.

    Raises:
        click.BadParameter: nothing can be written to it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as exc:
        text = os.strerror(exc.errno or 0)
        raise click.BadParameter(f"{folder}: {text}, expected a folder that can be written to") from exc
