"""Shared parts of the experts: tool motion, motion planning and clearance."""
