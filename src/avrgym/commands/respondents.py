"""People who consent to the participation, and people who answer questionnaires."""

CONSENT_ROLES = ("participant", "proxy", "assent")
"""Roles in which a consent is given: the participant; a representative; the participant who assents to the consent of a
representative."""
RESPONDENTS = ("participant", "proxy", "caregiver")
"""People who answer questionnaires: the participant; a proxy for the participant; a caregiver for themselves."""
ANSWERING = RESPONDENTS[:2]
"""People who answer the questions to a participant."""
PROXY, CAREGIVER = RESPONDENTS[1:]
