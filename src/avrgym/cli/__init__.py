"""The command line interface. Most files contain a group of commands."""

from avrgym.cli.main import app

__all__ = ["app"]
