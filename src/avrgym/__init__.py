"""AVR Gym: real people meet simulated assistive robots in virtual reality."""
