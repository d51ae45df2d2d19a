"""A hosted study for the tests of a module."""

from collections.abc import Iterator

import pytest

from avrgym.hosting.capacity import Capacity
from avrgym.hosting.host import Host
from avrgym.study.storage.store import Store
from helpers.hosting.served_host import Served
from helpers.studies.small_studies import small_study


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = small_study(tmp_path_factory.mktemp("hosted") / "study")
    (folder / "host.toml").write_text(
        'headset_check = false\n[completed]\ncode = "DONE"\n[screened_out]\ncode = "OUT"\n[withdrawn]\ncode = "LEFT"\n'
    )
    with pytest.MonkeyPatch.context() as patch, Store(folder) as store, Host(store, max_sessions=3) as host:
        patch.setattr(Capacity, "idle_cores", None)  # other tests use the processors
        yield Served(host)
