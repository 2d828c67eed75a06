"""Addresses that a server is to listen on: refused before anything slow is imported or another program takes over."""

from __future__ import annotations

import errno
import ipaddress
import socket

from dieseltwin.errors import InputError


def check_address(host: str, port: int) -> None:
    """Refuse what no server can listen on now.

    Raises:
        InputError: no port, a port that another program has, no address of this machine.
    """
    if not 1 <= port <= 65535:
        raise InputError("--port", port, "1 to 65535", "choose one of them")
    if not host.isascii() or not host.strip():  # nothing would mean every address of this machine
        raise InputError("--host", repr(host), "an address or a name of this machine", "leave it out for 127.0.0.1")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        got = "taken by another program" if taken else (error.strerror or str(error)).lower()
        raise InputError(f"--host {host} --port {port}", got, "an address of this machine and a free port",
                         "choose another --port" if taken else "check --host and --port") from None


def is_address(host: str) -> bool:
    """Whether it is one in figures, not a name."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it."""
    return host == "localhost" or (is_address(host) and ipaddress.ip_address(host).is_loopback)
