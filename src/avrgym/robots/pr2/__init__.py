"""Willow Garage's PR2: two arms of seven joints on a mobile base."""
