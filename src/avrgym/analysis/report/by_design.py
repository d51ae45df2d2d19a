"""Descriptions of designs: one if all participants had the same, else one for each group of participants."""

from collections.abc import Callable, Iterable

from avrgym.study.design.design import Design
from avrgym.study.storage.session_designs import SessionDesign, describe_trials


def by_design(uses: Iterable[SessionDesign], design: Design, words: Callable[[Design], str]) -> str:
    """Texts of ``words`` about the designs of ``uses``, or about ``design`` if nobody took part yet."""
    groups: dict[str, list[SessionDesign]] = {}
    for use in uses:
        groups.setdefault(words(use.design), []).append(use)
    if len(groups) < 2:
        return next(iter(groups), None) or words(design)
    return " ".join(f"For {describe_trials(own)}: {_sentence(text)}" for text, own in groups.items())


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
