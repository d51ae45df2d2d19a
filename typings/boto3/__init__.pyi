"""boto3 creates its clients at run time, so they count as ``Any``."""

from typing import Any

def client(service_name: str, *, config: Any = None) -> Any: ...
