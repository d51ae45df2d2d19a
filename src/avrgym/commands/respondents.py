"""People who consent to the participation, and people who answer questionnaires."""

RESPONDENTS = ("participant", "proxy", "caregiver")
"""People who answer questionnaires: the participant; a proxy for the participant; a caregiver for themselves."""
PARTICIPANT, PROXY, CAREGIVER = RESPONDENTS
ANSWERING = (PARTICIPANT, PROXY)
"""People who answer the questions to a participant."""
CONSENT_ROLES = (PARTICIPANT, PROXY, "assent")
"""Roles in which a consent is given: the participant; a representative; the participant who assents to the consent of a
representative."""
