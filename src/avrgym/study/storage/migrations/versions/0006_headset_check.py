"""Tables of 0.2.0, the first release. New databases are created from ``schema`` without migrations."""

revision = "0006_headset_check"
down_revision = None


def upgrade() -> None:
    raise NotImplementedError("databases from before 0.2.0 cannot be upgraded")
