"""Making the study that others are merged into: their design, plan and policies, and nobody in it yet."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tomlkit

from avrgym.study.checking.preflight import policies_needed
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import LOCAL
from avrgym.study.design.toml import read_text
from avrgym.study.design.word_files import word_files
from avrgym.study.plan.evidence import REGISTRATION, STAMP
from avrgym.study.plan.freezing import FROZEN
from avrgym.study.plan.plan import FILE as PLAN
from avrgym.study.storage import ledger, schema
from avrgym.study.storage.store import Store
from avrgym.system.files import make_private_folder, write_folder_whole, write_new


def make_merged_study(like: Store, names: Mapping[int, str], out: Path) -> None:
    """Make a study like one of its sites, in a new folder; ``names`` are those of its sites by number."""

    def write(folder: Path) -> None:
        write_new(folder / DESIGN, _without_local(read_text(like.folder / DESIGN)))
        for name in _own_files(like):
            make_private_folder((folder / name).parent)
            shutil.copyfile(like.folder / name, folder / name)
        with Store(folder) as store, store.database.write() as connection:
            for number, name in names.items():
                ledger.insert(connection, schema.SITE, number=number, name=name, entries=0, digest="")

    write_folder_whole(out, write)


def _without_local(design: str) -> str:
    """The text of a design without what a site says for itself alone; all else stays as it is, byte by byte."""
    document: Any = tomlkit.parse(design)
    if not any(document.get(name) for name in LOCAL):
        return design
    for name in LOCAL:
        document.pop(name, None)
    return tomlkit.dumps(document)


def _own_files(store: Store) -> Iterator[Path]:
    """The files of a study, relative to its folder, that its design and plan need."""
    own = [
        store.folder / name
        for name in (PLAN, FROZEN, STAMP, REGISTRATION, *word_files(store.design, store.folder))
    ]
    own += [Path(store.policy_source(*needed)) for needed in policies_needed(store)]
    for path in dict.fromkeys(own):
        if path.is_relative_to(store.folder) and path.is_file():
            yield path.relative_to(store.folder)
