"""A TCP proxy that behaves like a slower network: delay, jitter, rate, loss, a stall, and a changed address.

Bytes stay in order, as in TCP. A lost packet is repeated after a round trip and three further packets (fast retransmit,
RFC 5681); everything behind it waits. This model replaces the network emulator of Linux where the kernel lacks it.
"""

import asyncio
import random
from contextlib import suppress
from dataclasses import dataclass

PACKET_BYTES = 1448
PACKET_INTERVAL_S = 0.01
CHUNK_BYTES = 1 << 16


@dataclass(frozen=True)
class Network:
    """A network. ``round_trip_ms``: without queues. ``rate_mbit``: of each direction; 0: no limit.

    ``stall_at_s``: a stall of 3 s begins at this time after the connection. ``drop_at_s``: the connection is dropped
    then once, as after a change of the address.
    """

    round_trip_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    rate_mbit: float = 0.0
    stall_at_s: float | None = None
    drop_at_s: float | None = None


STALL_S = 3.0
WEBSOCKET_BYTES = 50_000
"""Connections that upload fewer bytes are requests; they are not dropped."""


class EmulatedNetwork:
    """Asynchronous context manager: a proxy to a local port. ``port``: its own port."""

    def __init__(self, network: Network, target_port: int, seed: int = 1) -> None:
        self._network, self._target = network, target_port
        self._random = random.Random(seed)
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_dropped = False
        self.port = 0

    async def __aenter__(self) -> "EmulatedNetwork":
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for task in self._tasks:
            task.cancel()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        other_reader, other_writer = await asyncio.open_connection("127.0.0.1", self._target)
        began_s = asyncio.get_running_loop().time()
        pairs = (reader, other_writer, True), (other_reader, writer, False)
        tasks = [asyncio.create_task(self._copy(*pair, began_s)) for pair in pairs]
        self._tasks.update(tasks)
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
            self._tasks.discard(task)
        for each in (writer, other_writer):
            each.close()

    async def _copy(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, is_upload: bool, began_s: float
    ) -> None:
        """Copy one direction; each chunk leaves at its own time, in order."""
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        sending = asyncio.create_task(self._send(waiting, writer))
        network, leaves_s, clock = self._network, 0.0, asyncio.get_running_loop().time
        copied = 0
        try:
            while data := await reader.read(CHUNK_BYTES):
                now_s = clock()
                age_s, copied = now_s - began_s, copied + len(data)
                is_due = network.drop_at_s is not None and age_s > network.drop_at_s
                if is_due and is_upload and copied > WEBSOCKET_BYTES and not self._is_dropped:
                    self._is_dropped = True
                    return
                arrives_s = now_s + self._delay_s(len(data))
                if network.stall_at_s is not None and 0.0 <= age_s - network.stall_at_s < STALL_S:
                    arrives_s = max(arrives_s, began_s + network.stall_at_s + STALL_S)
                rate = network.rate_mbit * 1e6
                leaves_s = max(leaves_s, arrives_s) + (8.0 * len(data) / rate if rate else 0.0)
                waiting.put_nowait((leaves_s, data))
        except ConnectionError:
            pass
        finally:
            sending.cancel()

    def _delay_s(self, size: int) -> float:
        network = self._network
        packets = -(-size // PACKET_BYTES)
        is_lost = self._random.random() > (1.0 - network.loss) ** packets
        jitter_s = network.jitter_ms / 1000.0 * self._random.uniform(-1.0, 1.0)
        one_way_s = max(network.round_trip_ms / 2000.0 + jitter_s, 0.0)
        repeat_s = network.round_trip_ms / 1000.0 + 3.0 * PACKET_INTERVAL_S
        return one_way_s + (repeat_s if is_lost else 0.0)

    async def _send(self, waiting: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
        clock = asyncio.get_running_loop().time
        with suppress(ConnectionError):
            while True:
                leaves_s, data = await waiting.get()
                await asyncio.sleep(max(leaves_s - clock(), 0.0))
                writer.write(data)
                await writer.drain()
