"""Tables of 0.2.0, the first release. New databases are created from ``schema`` without migrations."""

revision = "0006_headset_check"
down_revision = None


def upgrade() -> None:
    raise NotImplementedError("databases of AVR Gym versions before 0.2.0 cannot be upgraded")
