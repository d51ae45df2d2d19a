"""The zoo: populations of partners with several behaviour styles.

Partners of a style differ in delay, amplitude and tempo.
"""
