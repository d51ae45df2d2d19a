"""Runs the command-line program: ``python -m avrgym`` is equivalent to ``avrgym``."""

from avrgym.cli import app

app()
