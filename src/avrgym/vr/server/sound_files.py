"""Sound files of a study: recordings of its texts, for devices without a voice in the participant's language."""

import re
from pathlib import Path

from fastapi import FastAPI, HTTPException, Request, Response

from avrgym.texts.interface_texts import LANGUAGE_TAG_PATTERN
from avrgym.vr.server.authentication import Tokens

SOUNDS_FOLDER = "sounds"
"""Folder of sound files in the study's folder. It contains ``LANGUAGE/NAME.mp3``, or files with another suffix in
``SOUND_MEDIA_TYPES``. A file's name is the key of a text under ``session``, or the id of an item."""
SOUND_MEDIA_TYPES = {".mp3": "audio/mpeg", ".ogg": "audio/ogg", ".wav": "audio/wav"}
_NAME = re.compile(r"[A-Za-z0-9_-]{1,100}")


def find_sound_file(folder: Path, language: str, name: str) -> Path | None:
    """Returns the sound file of a text; ``None`` without a file."""
    if not LANGUAGE_TAG_PATTERN.fullmatch(language) or not _NAME.fullmatch(name):
        return None
    files = (folder / language / f"{name}{suffix}" for suffix in SOUND_MEDIA_TYPES)
    return next((file for file in files if file.is_file()), None)


def add_sound_route(app: FastAPI, tokens: Tokens, folder: Path | None) -> None:
    """Add the route of sound files. Without a file, the response has status 204. ``folder``: see ``SOUNDS_FOLDER``."""

    @app.get("/sounds/{language}/{name}")
    def sound(language: str, name: str, request: Request) -> Response:
        if tokens.authenticate_request(request.headers) is None:
            raise HTTPException(401, "the request has no valid token; send one in the Authorization header")
        file = None if folder is None else find_sound_file(folder, language, name)
        if file is None:
            return Response(status_code=204)
        return Response(file.read_bytes(), media_type=SOUND_MEDIA_TYPES[file.suffix])
