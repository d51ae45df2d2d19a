"""Packaged robots, each in its own folder, and the registry of robots."""
