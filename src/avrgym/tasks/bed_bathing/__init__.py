"""Bed bathing: wipe the right arm of a person who lies in a hospital bed (paper, section IV)."""
