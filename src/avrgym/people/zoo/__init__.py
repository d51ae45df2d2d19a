"""The zoo of partners: behaviour styles, each with several amplitudes, delays and tempos."""
