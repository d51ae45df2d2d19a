"""Feeding: bring a spoon with eight pieces of food to the person's mouth (paper, section IV)."""
