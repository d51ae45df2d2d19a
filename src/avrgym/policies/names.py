"""What ``--policy`` takes, by name."""

SCRIPTS = ("oracle", "random", "zero")
OPERATOR = "operator"
FORMS = "FILE.safetensors, FILE.onnx, MODULE:ATTRIBUTE"
CHOICES = f"original, revised, {', '.join(SCRIPTS)}, {FORMS}, or the name of a plug-in's controller"
"""What ``--policy`` takes everywhere."""
