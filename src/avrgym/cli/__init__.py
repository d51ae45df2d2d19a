"""The command line interface. Each file contains a group of commands."""

from avrgym.cli.main import app

__all__ = ["app"]
