"""The package's folders are all that is used of it."""

__path__: list[str]
