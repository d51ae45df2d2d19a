"""Dressing: pull the sleeve of a gown over the left arm of a seated person, to the shoulder."""
