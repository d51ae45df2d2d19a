"""``python -m avrgym`` is the program ``avrgym``."""

from avrgym.cli import app

app()
