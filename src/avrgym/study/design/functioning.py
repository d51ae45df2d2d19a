"""Questions about disability, diagnosis and assistive devices. Participants may decline each question.

The questions about functioning are the Washington Group's Short Set on Functioning, with its four levels. The answers
about devices are the classes of assistive products in ISO 9999:2022, with shortened names. Translations of questions
and answers are not validated.
"""

from collections.abc import Iterator, Mapping

FUNCTIONING_QUESTIONS: Mapping[str, str] = {
    "seeing": "Do you have difficulty seeing, even if wearing glasses?",
    "hearing": "Do you have difficulty hearing, even if using a hearing aid?",
    "walking": "Do you have difficulty walking or climbing steps?",
    "remembering": "Do you have difficulty remembering or concentrating?",
    "self_care": "Do you have difficulty with self-care, such as washing all over or dressing?",
    "communicating": "Using your usual language, do you have difficulty communicating, for example understanding or "
    "being understood?",
}
NONE_ANSWER, DECLINED_ANSWER = "none", "declined"
DIFFICULTY_LEVELS: Mapping[str, str] = {
    NONE_ANSWER: "no difficulty",
    "some": "some difficulty",
    "a lot": "a lot of difficulty",
    "cannot": "cannot do at all",
    DECLINED_ANSWER: "I prefer not to answer",
}
ASSISTIVE_DEVICES_QUESTION = "Which assistive devices do you use in daily life?"
ASSISTIVE_DEVICES: Mapping[str, str] = {
    "04": "for treatment or training of the body",
    "05": "for learning skills",
    "06": "braces, splints or artificial limbs",
    "09": "for eating, washing, dressing or using the toilet",
    "12": "for moving around, such as a wheelchair or a cane",
    "15": "for housework",
    "18": "furniture and fittings, such as an adjustable bed",
    "22": "for seeing, hearing, speaking or using a computer",
    "24": "for reaching, gripping or carrying things",
    "27": "for controlling the surroundings",
    "28": "for work",
    "30": "for leisure",
    NONE_ANSWER: "none of these",
    DECLINED_ANSWER: "I prefer not to answer",
}
"""Assistive devices: classes of ISO 9999 by their numbers, and the answers ``none`` and ``declined``."""
DIAGNOSIS_QUESTION = "Which diagnosis do you want to name? You need not answer."


def list_functioning_sentences() -> Iterator[str]:
    """Yields all sentences about functioning that participants read, before translation."""
    yield from FUNCTIONING_QUESTIONS.values()
    yield from DIFFICULTY_LEVELS.values()
    yield from ASSISTIVE_DEVICES.values()
    yield ASSISTIVE_DEVICES_QUESTION
    yield DIAGNOSIS_QUESTION
