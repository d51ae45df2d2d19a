"""Roles of the people that give consent, and of the people that answer questionnaires."""

RESPONDENTS = ("participant", "proxy", "caregiver")
"""Respondents of questionnaires: the participant, a proxy (answers for the participant), or a caregiver (gives their
own answers)."""
PARTICIPANT_RESPONDENT, PROXY_RESPONDENT, CAREGIVER_RESPONDENT = RESPONDENTS
PARTICIPANT_RESPONDENTS = (PARTICIPANT_RESPONDENT, PROXY_RESPONDENT)
"""Allowed respondents of the questions that are addressed to a participant."""
CONSENT_ROLES = (PARTICIPANT_RESPONDENT, PROXY_RESPONDENT, "assent")
"""Roles of a consent: the participant's own consent, the consent of a representative, the participant's assent."""
