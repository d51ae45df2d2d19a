"""Bed bathing: wipe markers off the right arm of a reclined person (paper, section IV)."""
