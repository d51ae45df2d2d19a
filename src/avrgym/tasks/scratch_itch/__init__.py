"""Itch scratching: scratch a random point on the person's right arm (paper, section IV)."""
