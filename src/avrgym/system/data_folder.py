"""The folder for files that belong to a user and not to a study: keys, tokens and certificates."""

from pathlib import Path

import platformdirs


def data_folder() -> Path:
    """Where this user's programs keep data; on Linux ``$XDG_DATA_HOME`` or ``~/.local/share``."""
    return platformdirs.user_data_path("avrgym", appauthor=False)
