"""Names that ``--policy`` takes."""

SCRIPTS = ("oracle", "random", "zero")
OPERATOR = "operator"
FORMS = "FILE.safetensors, FILE.onnx, MODULE:ATTRIBUTE"
CHOICES = f"original, revised, {', '.join(SCRIPTS)}, {FORMS}, or the name of a plug-in's controller"
