"""A zoo of partners: named styles in which people behave, each in many strengths, delays and tempos."""
