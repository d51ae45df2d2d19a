"""AVR Gym: real people meet simulated assistive robots in virtual reality.

Importing the package registers the Gymnasium environments.
"""

from avrgym.envs import register

register()
