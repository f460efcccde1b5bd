"""What a program could do that had got into the daemon's place: it tries, and tells how it went.

The standard library alone; each attempt by itself; one line of JSON at the end.
"""

import ctypes
import json
import mmap
import os
import socket
from collections.abc import Callable
from pathlib import Path

PTRACE_ATTACH = 16
CLONE_NEWUSER = 0x10000000
LIBC = ctypes.CDLL(None, use_errno=True)


def checked(result: int) -> None:
    """Raise what the C library says."""
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))


def loopback() -> None:
    """Send a datagram to this host, which it must be able to."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        one.settimeout(1.0)
        one.sendto(b"x", one.getsockname())
        one.recv(1)


def raw_socket() -> None:
    """Listen to everybody's packets."""
    socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()


def executable_memory() -> None:
    """Make code of data."""
    everything = mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
    mmap.mmap(-1, 4096, prot=everything).close()


def set_user_id() -> None:
    """Leave a program behind that runs as somebody else."""
    path = Path("/var/lib/probe/x")
    path.write_bytes(b"")
    path.chmod(0o4755)


def module() -> None:
    """Ask the kernel for a module."""
    checked(LIBC.syscall(175, None, 0, b""))


ATTEMPTS: dict[str, Callable[[], object]] = {
    "its own directory": lambda: Path("/var/lib/probe/y").write_text("y"),
    "loopback": loopback,
    "write /etc": lambda: Path("/etc/linemate/x").write_text("x"),
    "write the program": lambda: Path("/opt/linemate/x").write_text("x"),
    "write /usr": lambda: Path("/usr/local/x").write_text("x"),
    "see /home": lambda: list(Path("/root").iterdir()),
    "see other processes": lambda: Path("/proc/1/cmdline").read_bytes(),
    "new namespace": lambda: checked(LIBC.unshare(CLONE_NEWUSER)),
    "raw socket": raw_socket,
    "ptrace": lambda: checked(LIBC.ptrace(PTRACE_ATTACH, os.getppid(), 0, 0)),
    "become root": lambda: os.setuid(0),
    "executable memory": executable_memory,
    "set-user-id": set_user_id,
    "kernel module": module,
    "host name": lambda: checked(LIBC.sethostname(b"x", 1)),
}


def main() -> None:
    """Try everything."""
    outcomes = {}
    for name, attempt in ATTEMPTS.items():
        try:
            attempt()
        except OSError as error:
            outcomes[name] = error.strerror or str(error)
        else:
            outcomes[name] = "done"
    print(json.dumps(outcomes), flush=True)


if __name__ == "__main__":
    main()
