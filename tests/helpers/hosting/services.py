"""A PostgreSQL database and an object store on this computer, for studies on several computers."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from avrgym.study.storage.database import DATABASE_URL_VARIABLE
from helpers.studies.object_store_server import object_store_server, set_object_store
from helpers.studies.small_studies import new_postgresql_database, postgresql_programs, postgresql_server
from helpers.system.processes import free_port


@contextmanager
def database_and_object_store() -> Iterator[subprocess.Popen[bytes]]:
    """Run both, and set the environment variables with their addresses. Yields the process of the object store."""
    programs, port = postgresql_programs(), free_port()
    if programs is None:
        pytest.skip("PostgreSQL's server is not installed (Debian: postgresql)")
    with (
        postgresql_server(programs) as server,
        object_store_server(port) as process,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv(DATABASE_URL_VARIABLE, new_postgresql_database(server))
        set_object_store(patch, port)
        yield process
