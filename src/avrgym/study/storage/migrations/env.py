"""Runs the migrations on the connection in ``attributes``, within its transaction. Alembic executes this file."""

from alembic import context

from avrgym.study.storage.schema import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
context.run_migrations()
