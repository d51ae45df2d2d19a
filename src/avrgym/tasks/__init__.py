"""The tasks (one folder and one ``Task`` each), their initial states, episodes and control loop."""
