"""Loopback addresses, the address for all network interfaces, and the default port of servers."""

LOOPBACK_HOSTS = ("127.0.0.1", "localhost")
ALL_INTERFACES = "0.0.0.0"
DEFAULT_PORT = 8000
