"""Loopback addresses, the address for all network interfaces, and the default port of servers."""

LOOPBACK = ("127.0.0.1", "localhost")
EVERY_ADDRESS = "0.0.0.0"
PORT = 8000
