"""Itch scratching: scratch a random spot on the person's right arm (paper, section IV)."""
