"""The command line: one subcommand per file of this room."""

from __future__ import annotations

import importlib
import sys
from typing import Annotated

import tyro

import corporeal
from corporeal.cli.commands import (
    Convert,
    Curate,
    Evaluate,
    Info,
    Joints,
    Learn,
    Merge,
    Pipeline,
    Register,
    Report,
    Simulate,
    Track,
    View,
)
from corporeal.cli.errors import CommandError

Command = (
    Annotated[Register, tyro.conf.subcommand("register")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Convert, tyro.conf.subcommand("convert")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Curate, tyro.conf.subcommand("curate")]
    | Annotated[Joints, tyro.conf.subcommand("joints")]
    | Annotated[Learn, tyro.conf.subcommand("learn")]
    | Annotated[Pipeline, tyro.conf.subcommand("pipeline")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Merge, tyro.conf.subcommand("merge")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Track, tyro.conf.subcommand("track")]
    | Annotated[View, tyro.conf.subcommand("view")]
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; 0 when every item has a row, 1 when nothing could be done, 2 for a wrong call."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments == ["--version"]:
        print(f"corporeal {corporeal.__version__}")
        return 0
    try:
        config = tyro.cli(
            Command,
            prog="corporeal",
            description="Learn, register, fit and export articulated surface models.",
            args=arguments,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        )
        return _run(config)
    except CommandError as error:
        print(f"corporeal: {error}", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        print("corporeal: interrupted", file=sys.stderr)
        return 130


def _run(config: Command) -> int:
    # Each command's module is imported when it is asked for: torch and numba take seconds.
    return importlib.import_module(f"corporeal.cli.{type(config).__name__.lower()}").run(config)


if __name__ == "__main__":
    sys.exit(main())
