"""What a package adds to AVR Gym."""
