"""An example package that extends AVR Gym."""
