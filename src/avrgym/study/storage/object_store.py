"""An object store with the S3 protocol, for a study's recordings. Requires the extra ``s3``.

The address is ``s3://BUCKET/FOLDER``. boto3 reads credentials and endpoint from its own environment variables, such as
``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY`` and ``AWS_ENDPOINT_URL``, or from ``~/.aws``. boto3 is synchronous, and
starts no thread in the process of a real-time session.
"""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from avrgym.study.design.design import OBJECT_STORE_URL_PATTERN
from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import PRIVATE_FILE_MODE, make_private_folder, write_atomically

OBJECT_STORE_VARIABLE = "AVRGYM_STUDY_RECORDINGS"
"""Environment variable with the object store's address. It replaces the address in ``study.toml``."""
CONNECT_TIMEOUT_S, READ_TIMEOUT_S = 5.0, 30.0
MAX_REQUEST_ATTEMPTS = 2


class ObjectStore:
    """The files of one study in an object store. Names are paths relative to the study's folder. Thread-safe.

    ``url``: the address. ``latest_error_message``: the error of the latest request; empty after a successful request.
    """

    def __init__(self, url: str) -> None:
        self.url, self.latest_error_message = url, ""
        self._bucket, _, folder = url.removeprefix("s3://").partition("/")
        self._prefix = f"{folder.strip('/')}/" if folder.strip("/") else ""

    def list_file_sizes(self, prefix: str = "") -> dict[str, int]:
        """Returns the size in bytes of each stored file with a name that begins with ``prefix``, by name.

        All methods raise ``StudyError`` if the object store cannot be used.
        """
        found, client = dict[str, int](), self._client
        with self._errors(), suppress(client.exceptions.NoSuchBucket):
            pages = client.get_paginator("list_objects_v2")
            for page in pages.paginate(Bucket=self._bucket, Prefix=self._prefix + prefix):
                found |= {
                    each["Key"].removeprefix(self._prefix): each["Size"] for each in page.get("Contents", ())
                }
        return found

    def upload_file(self, name: str, path: Path) -> int:
        """Store the file at ``path``. Returns its size in bytes. A missing bucket is created."""
        content, client = path.read_bytes(), self._client
        put = {"Bucket": self._bucket, "Key": self._prefix + name, "Body": content}
        with self._errors():
            try:
                client.put_object(**put)
            except client.exceptions.NoSuchBucket:
                client.create_bucket(Bucket=self._bucket)
                client.put_object(**put)
        return len(content)

    def download_file(self, name: str, path: Path) -> None:
        """Write a stored file to ``path`` atomically. Only its owner can read it."""
        client = self._client
        with self._errors():
            response = client.get_object(Bucket=self._bucket, Key=self._prefix + name)
            content = response["Body"].read()
        make_private_folder(path.parent)
        write_atomically(path, content, PRIVATE_FILE_MODE)

    def delete_files(self, prefix: str) -> None:
        """Delete all stored files with names that begin with ``prefix``."""
        for name in self.list_file_sizes(prefix):
            with self._errors():
                self._client.delete_object(Bucket=self._bucket, Key=self._prefix + name)

    @cached_property
    def _client(self) -> Any:
        try:
            import boto3
            from botocore.config import Config
        except ModuleNotFoundError as error:
            raise StudyError(f"{error.name} is missing; run `pip install 'avrgym[s3]'`") from error
        limits = Config(
            connect_timeout=CONNECT_TIMEOUT_S,
            read_timeout=READ_TIMEOUT_S,
            retries={"total_max_attempts": MAX_REQUEST_ATTEMPTS},
        )
        return boto3.client("s3", config=limits)

    @contextmanager
    def _errors(self) -> Generator[None]:
        from botocore.exceptions import BotoCoreError, ClientError

        try:
            yield
        except (BotoCoreError, ClientError, OSError) as error:
            self.latest_error_message = f"the object store {self.url} cannot be used: {error}"
            raise StudyError(self.latest_error_message) from error
        self.latest_error_message = ""


def open_object_store(configured: str) -> ObjectStore | None:
    """Returns the object store of a study; ``None`` if the address is empty.

    ``configured``: the address in ``study.toml``; the environment variable replaces it. Raises ``StudyError`` for an
    invalid address.
    """
    url = os.environ.get(OBJECT_STORE_VARIABLE, configured)
    if url and not OBJECT_STORE_URL_PATTERN.fullmatch(url):
        raise StudyError(
            f"{OBJECT_STORE_VARIABLE} is not an address of an object store; allowed: s3://bucket/folder"
        )
    return ObjectStore(url) if url else None
