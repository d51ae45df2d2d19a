"""Packaged robots, one folder each, and the registry."""
