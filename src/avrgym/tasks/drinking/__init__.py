"""Drinking: bring a cup to the person's mouth and tilt it until they have drunk (paper, section IV)."""
