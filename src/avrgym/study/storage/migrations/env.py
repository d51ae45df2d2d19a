"""Run by Alembic on a connection that it is given, within that connection's transaction."""

from alembic import context

from avrgym.study.storage.schema import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
context.run_migrations()
