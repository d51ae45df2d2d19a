"""The controller WaveArm for AVR Gym."""
