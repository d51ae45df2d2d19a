"""The files beside ``study.toml`` in which a study has words of its own that participants read."""

from pathlib import Path

from avrgym.study.design.design import Design
from avrgym.study.design.instruments import FOLDER as INSTRUMENTS
from avrgym.texts.texts import FOLDER as TEXTS


def word_files(design: Design, folder: Path) -> list[str]:
    """Translations, and words of instruments that AVR Gym may not bring, as far as a design takes them from a folder.

    Names are relative to the folder, with ``/``.
    """
    used = dict.fromkeys(each.use for each in design.questionnaires if each.use)
    names = [f"{TEXTS}/{language}.toml" for language in design.languages]
    names += [f"{INSTRUMENTS}/{name}.toml" for name in used]
    return [name for name in names if (folder / name).is_file()]
