"""Roles of the people that give consent, and of the people that answer questionnaires."""

RESPONDENTS = ("participant", "proxy", "caregiver")
"""Respondents of questionnaires: the participant, a proxy (answers for the participant), or a caregiver (gives their
own answers)."""
PARTICIPANT, PROXY, CAREGIVER = RESPONDENTS
PARTICIPANT_RESPONDENTS = (PARTICIPANT, PROXY)
"""Allowed respondents of the questions that are addressed to a participant."""
CONSENT_ROLES = (PARTICIPANT, PROXY, "assent")
"""Roles of a consent: the participant's own consent, the consent of a representative, the participant's assent."""
