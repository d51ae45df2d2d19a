"""Names that ``--policy`` accepts."""

SCRIPTS = ("oracle", "random", "zero")
OPERATOR = "operator"
FORMS = "FILE.safetensors, FILE.onnx, MODULE:ATTRIBUTE"
CHOICES = f"original, revised, {', '.join(SCRIPTS)}, {FORMS}, or the name of a plug-in's controller"
