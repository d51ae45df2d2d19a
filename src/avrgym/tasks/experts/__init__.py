"""Shared parts of experts: tool motion, motion planning and clearance."""
