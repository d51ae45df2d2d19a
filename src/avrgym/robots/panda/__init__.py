"""Franka Emika's Panda: seven joints and a parallel gripper, on a stand."""
