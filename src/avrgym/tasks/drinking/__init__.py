"""Drinking: bring a cup to the person's mouth and tilt it until the person has drunk (paper, section IV)."""
