"""Names of policies that the option ``--policy`` accepts."""

SCRIPTED_POLICIES = ("oracle", "random", "zero")
OPERATOR_POLICY = "operator"
DEFAULT_POLICIES = ("adaptive", "revised", "oracle")
"""Default policies of sessions without `--policy`: the first of these names that the environment has."""
POLICY_FILE_FORMS = "FILE.safetensors, FILE.onnx, MODULE:ATTRIBUTE, lerobot:FOLDER"
POLICY_CHOICES = (
    f"adaptive, original, revised, {', '.join(SCRIPTED_POLICIES)}, {POLICY_FILE_FORMS}, or the "
    f"name of a plug-in's controller"
)
