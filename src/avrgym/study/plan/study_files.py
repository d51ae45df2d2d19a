"""Files in a study's folder that its design and its plan need: plan, texts and policies."""

from collections.abc import Iterator
from pathlib import Path

from avrgym.study.checking.preflight import list_environment_policy_pairs
from avrgym.study.design.languages import find_text_files
from avrgym.study.plan.analysis_plan import PLAN_FILE as PLAN
from avrgym.study.plan.date_evidence import REGISTRATION_FILE, TIME_STAMP_FILE
from avrgym.study.plan.frozen_plan import FROZEN_PLAN_FILE
from avrgym.study.storage.store import StudyStore


def list_study_files(store: StudyStore) -> Iterator[Path]:
    """Yields the paths of these files, relative to the study's folder. ``study.toml`` is not among them."""
    own = [
        store.folder / name
        for name in (
            PLAN,
            FROZEN_PLAN_FILE,
            TIME_STAMP_FILE,
            REGISTRATION_FILE,
            *find_text_files(store.design, store.folder),
        )
    ]
    own += [Path(store.find_policy_source(*needed)) for needed in list_environment_policy_pairs(store)]
    for path in dict.fromkeys(own):
        if path.is_relative_to(store.folder) and path.is_file():
            yield path.relative_to(store.folder)
