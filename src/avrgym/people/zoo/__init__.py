"""The zoo: populations of simulated people (partners of the robot) with several behaviour styles.

Partners of one style differ in delay, amplitude and tempo of their behaviour.
"""
