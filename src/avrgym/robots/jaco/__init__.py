"""Kinova's Jaco Gen2: seven joints, a spherical wrist, three fingers."""
