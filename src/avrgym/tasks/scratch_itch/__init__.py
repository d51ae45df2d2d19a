"""Itch scratching: rub the spot of the right arm that itches, gently and to and fro (paper, section IV)."""
