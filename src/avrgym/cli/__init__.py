"""The command line: one program, one file for each group of commands."""

from avrgym.cli.main import app

__all__ = ["app"]
