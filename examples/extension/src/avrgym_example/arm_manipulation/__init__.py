"""Arm manipulation: lift the person's limp right forearm, which has slid off, back onto the armrest."""
