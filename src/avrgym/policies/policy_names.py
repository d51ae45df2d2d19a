"""Names of policies that the option ``--policy`` accepts."""

SCRIPTED_POLICY_NAMES = ("oracle", "random", "zero")
OPERATOR_POLICY_NAME = "operator"
DEFAULT_POLICY_NAMES = ("adaptive", "revised", "oracle")
"""Default policies of sessions without `--policy`: the first of these names that the environment has."""
POLICY_FILE_FORMS_TEXT = "FILE.safetensors, FILE.onnx, MODULE:ATTRIBUTE, lerobot:FOLDER"
POLICY_CHOICES_TEXT = (
    f"adaptive, original, revised, {', '.join(SCRIPTED_POLICY_NAMES)}, {POLICY_FILE_FORMS_TEXT}, or the "
    f"name of a plug-in's controller"
)
