"""Alembic runs this file in the transaction of a given connection."""

from alembic import context

from avrgym.study.storage.schema import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
context.run_migrations()
