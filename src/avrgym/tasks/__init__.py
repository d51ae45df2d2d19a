"""The tasks (one folder and one ``Task`` each), initial states, episodes and the control loop."""
