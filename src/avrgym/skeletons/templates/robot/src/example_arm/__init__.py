"""The robot ExampleArm for AVR Gym."""
