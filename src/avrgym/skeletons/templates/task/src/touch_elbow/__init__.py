"""The task TouchElbow for AVR Gym."""
