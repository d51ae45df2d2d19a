"""Names that ``--policy`` accepts."""

SCRIPTS = ("oracle", "random", "zero")
OPERATOR = "operator"
PREFERRED_POLICIES = ("adaptive", "revised", "oracle")
"""Default policies of sessions without `--policy`: the first of these names that the environment has."""
FILE_FORMS = "FILE.safetensors, FILE.onnx, MODULE:ATTRIBUTE, lerobot:FOLDER"
POLICY_CHOICES = (
    f"adaptive, original, revised, {', '.join(SCRIPTS)}, {FILE_FORMS}, or the name of a plug-in's controller"
)
