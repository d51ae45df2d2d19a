"""Arm manipulation: lift the limp right forearm of a seated person back onto the armrest."""
