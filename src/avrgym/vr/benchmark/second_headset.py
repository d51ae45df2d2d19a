"""The second headset of the latency measurement: a demonstrator who steers the robot, in its own process."""

import time
from multiprocessing.connection import Connection
from threading import Event, Thread

import numpy as np
from websockets.sync.client import ClientConnection, connect

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import ControllerPoseCommand, XRPose

STEERING_HZ = 90.0
"""Number of steering messages per second."""
CIRCLE_RADIUS_M, CIRCLE_HZ = 0.03, 0.3
"""Radius in metres and frequency in Hz of the circle on which the controller moves."""
LEVEL = 0.0, 0.0, 0.0, 1.0


def run_demonstrator(url: str, token: str, results: Connection) -> None:
    """Main function of the demonstrator's process: steers until the trial ends.

    At the end, the times at which steering messages were sent are sent to ``results``, in order.
    """
    with connect(url, max_size=None) as socket:
        _send(socket, messages.Hello(messages.PROTOCOL_VERSION, token, "benchmark", emulated=True))
        results.send(_steer_until_end(socket))


def _steer_until_end(socket: ClientConnection) -> list[float]:
    driving, over = Event(), Event()
    sent: list[float] = []
    sender = Thread(target=_steer, args=(socket, driving, over, sent))
    sender.start()
    states = 0
    while not over.is_set():
        message = messages.decode_server_message(bytes(socket.recv(decode=False)))
        if isinstance(message, messages.WorldStateChange):
            states += 1
            if states % messages.STATES_PER_RECEIPT == 0:
                _send(socket, messages.StateReceipt(states))
        elif isinstance(message, messages.PhaseDescription):
            if message.name == "trial":
                driving.set()
            elif message.name == "free_after":
                over.set()
    sender.join()
    return sent


def _steer(socket: ClientConnection, driving: Event, over: Event, sent: list[float]) -> None:
    view = XRPose((0.0, 0.0, 0.0), LEVEL)
    driving.wait()
    began = due = time.monotonic()
    while not over.is_set():
        angle = 2.0 * np.pi * CIRCLE_HZ * (due - began)
        x, y = CIRCLE_RADIUS_M * np.sin(angle), 1.0 + CIRCLE_RADIUS_M * np.cos(angle)
        grip = XRPose((float(x), float(y), 0.0), LEVEL)
        sent.append(time.monotonic())
        _send(socket, ControllerPoseCommand(clutch=True, grip=grip, xr_from_world=view, scale=1.0))
        due += 1.0 / STEERING_HZ
        time.sleep(max(0.0, due - time.monotonic()))


def _send(socket: ClientConnection, message: messages.Message) -> None:
    socket.send(messages.encode_message(message))
