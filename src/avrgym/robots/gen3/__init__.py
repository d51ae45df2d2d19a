"""Kinova's Gen3: seven joints and the hand of the Gen3 lite."""
