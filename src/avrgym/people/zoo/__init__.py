"""The zoo: partner populations with behaviour styles, each with several amplitudes, delays and tempos."""
