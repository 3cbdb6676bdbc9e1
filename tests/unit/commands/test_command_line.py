"""Every command explains itself, leaves out ROS's remappings, and ends with the status that its usage promises."""

from __future__ import annotations

import importlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import pytest

from hitchhike_ros.commands import demo
from hitchhike_ros.commands.command_line import folder_option, help_of, json_option, run
from hitchhike_ros.core.errors import HitchhikeError

COMMANDS = (
    *("awards", "bench", "costs", "demo", "draw_machines", "experiments", "make_marker", "map_saver"),
    "octomap_saver",
)


@pytest.fixture(autouse=True)
def signals_as_they_were() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def status_of(main: Callable[[], None], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int | str | None:
    monkeypatch.setattr("sys.argv", ["program", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module(f"hitchhike_ros.commands.{name}")
    assert not status_of(module.main, monkeypatch, "--help", "__ns:=/p3dx", "__name:=other")
    said = capsys.readouterr().out
    assert said.startswith(f"Usage: {name}") and "--help" in said


@pytest.mark.parametrize("name", COMMANDS)
def test_an_unknown_option_is_wrong_usage(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module(f"hitchhike_ros.commands.{name}")
    assert status_of(module.main, monkeypatch, "--gibberish") == 2
    assert "--gibberish" in capsys.readouterr().err


def test_the_demos_usage_names_each_of_its_options() -> None:
    """The docstring is what stands in for --help before the set-up."""
    usage = (demo.__doc__ or "").partition("\n\n")[0]
    options = {name for parameter in demo.command.params for name in parameter.opts} | {"--help"}
    assert {word.strip("[]") for word in usage.replace("\n", " ").split() if word.startswith("[--")} == options


def failing(exc: BaseException) -> Callable[[], None]:
    @click.command("fail")
    def command() -> None:
        raise exc

    return lambda: run(command, "stopped")


@pytest.mark.parametrize(
    ("exc", "status", "said"),
    [
        (HitchhikeError("no map"), 1, "fail: no map\n"),
        (click.UsageError("too few"), 2, "too few"),
        (click.FileError("a.json", "is a folder"), 1, "is a folder"),
        (KeyboardInterrupt(), 130, "stopped"),
    ],
)
def test_what_goes_wrong_is_said_and_has_its_status(
    exc: BaseException,
    status: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert status_of(failing(exc), monkeypatch) == status
    assert said in capsys.readouterr().err


def test_a_command_returns_its_status(monkeypatch: pytest.MonkeyPatch) -> None:
    @click.command("well")
    @click.argument("status", type=int)
    def command(status: int) -> int | None:
        return status or None

    assert status_of(lambda: run(command), monkeypatch, "3", "other:=4") == 3
    assert not status_of(lambda: run(command), monkeypatch, "0")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_programs_is_as_ctrl_c(number: signal.Signals, monkeypatch: pytest.MonkeyPatch) -> None:
    @click.command("wait")
    def command() -> None:
        signal.raise_signal(number)

    assert status_of(lambda: run(command), monkeypatch) == 130


def test_folders_are_made_and_those_that_cannot_be_written_are_wrong_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[tuple[Path, Path | None]] = []

    @click.command("write")
    @folder_option("--output", default="nowhere", text="Folder.")
    @json_option
    def command(output: Path, json_file: Path | None) -> None:
        given.append((output, json_file))

    folder, file = tmp_path / "a" / "b", tmp_path / "c" / "figures.json"
    assert not status_of(lambda: run(command), monkeypatch, "--output", str(folder), "--json", str(file))
    assert given == [(folder, file)]
    assert folder.is_dir() and file.parent.is_dir()
    assert not status_of(lambda: run(command), monkeypatch, "--output", str(folder))
    assert given[1] == (folder, None)
    file.write_text("")
    for arguments in (("--output", f"{file}/x"), ("--output", str(folder), "--json", f"{file}/x/y.json")):
        assert status_of(lambda: run(command), monkeypatch, *arguments) == 2
        assert "expected a folder that can be written to" in capsys.readouterr().err


def test_help_fills_paragraphs_and_keeps_what_is_indented() -> None:
    text = help_of("First line\nand more.\n\nLike this:\n  a b\n  c d\n\nLast.\n")
    assert text == "First line\nand more.\n\n\b\nLike this:\n  a b\n  c d\n\nLast."
