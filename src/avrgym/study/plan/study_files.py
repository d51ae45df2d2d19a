"""Files in a study's folder that its design and its plan need: plan, texts and policies."""

from collections.abc import Iterator
from pathlib import Path

from avrgym.study.checking.preflight import environment_policy_pairs
from avrgym.study.design.languages import text_files
from avrgym.study.plan.frozen_plan import FROZEN_PLAN_FILE
from avrgym.study.plan.plan import FILE as PLAN
from avrgym.study.plan.timestamps import REGISTRATION_FILE, TIME_STAMP_FILE
from avrgym.study.storage.store import Store


def study_files(store: Store) -> Iterator[Path]:
    """Yields the paths of these files, relative to the study's folder. ``study.toml`` is not among them."""
    own = [
        store.folder / name
        for name in (
            PLAN,
            FROZEN_PLAN_FILE,
            TIME_STAMP_FILE,
            REGISTRATION_FILE,
            *text_files(store.design, store.folder),
        )
    ]
    own += [Path(store.policy_source(*needed)) for needed in environment_policy_pairs(store)]
    for path in dict.fromkeys(own):
        if path.is_relative_to(store.folder) and path.is_file():
            yield path.relative_to(store.folder)
