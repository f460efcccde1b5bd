"""Texts of the manual pages: purposes, exit codes, files, examples."""

import argparse
from collections.abc import Iterator
from typing import Any

from linemate.daemon.operator import main as operator
from linemate.daemon.service import main as service
from linemate.simulators.harness import main as harness

Page = tuple[argparse.ArgumentParser, int, str, dict[str, list[str]]]

_SEE = "SEE ALSO"

LINEMATE: dict[str, list[str]] = {
    "DESCRIPTION": [
        "Shows the status of a running linemated(8), and sends it an operator's orders. Without"
        " --udp it uses the daemon's local socket, for which root and members of the socket's group"
        " need no key. With --udp it needs a key, which `linemate keygen` makes.",
        "Errors are one line on standard error. With --json every command prints one map with a"
        " version; within a version keys are only ever added.",
    ],
    "EXIT STATUS": [
        "0\tDone; for status: healthy; for replay: identical.",
        "1\tRefused, with the reason; for status: degraded or fault; for replay: different.",
        "2\tThe command line was wrong, or the key file cannot be used.",
        "3\tNo daemon answered.",
        "78\tA bad configuration, with every error as file:line:column: key: what.",
    ],
    "ENVIRONMENT": [
        "LINEMATE_SOCKET\tThe daemon's local socket.",
        "NO_COLOR\tNo colours in --watch.",
        "XDG_CONFIG_HOME\tWhere linemate/key is looked for; ~/.config.",
    ],
    "FILES": [
        "/run/linemate/command.sock\tThe local socket of linemated.service; that of"
        " linemated@NAME.service is /run/linemate-NAME/command.sock.",
        "~/.config/linemate/key\tThe operator's key for --udp, which no one else may read.",
    ],
    "EXAMPLES": [
        "  linemate status --watch\n  linemate param set tracking.camera.gate=6\n"
        "  linemate param save",
        "Three lines for a script: act only on a healthy station.",
        "  if linemate status --json >status.json; then\n"
        "      linemate arm && linemate start\n  fi",
    ],
    _SEE: ["linemated(8), linemate-sim(1), linemated.yaml(5)"],
}

LINEMATED: dict[str, list[str]] = {
    "DESCRIPTION": [
        "Leads an industrial robot that works on a moving conveyor: takes the controller's RSI"
        " telegrams, the distance sensor's CAN frames, the camera's poses and the force-torque"
        " sensor's stream, and answers each telegram with one correction.",
        "It notifies systemd when it is ready, feeds its watchdog from the control cycle, reloads"
        " the operators' keys on SIGHUP, and on SIGTERM brings the robot to rest before it ends.",
    ],
    "EXIT STATUS": [
        "0\tEnded as ordered.",
        "1\tCannot run: a port is taken.",
        "2\tThe command line was wrong.",
        "78\tBad configuration: every error on standard error as file:line:column: key: what.",
    ],
    "ENVIRONMENT": [
        "NOTIFY_SOCKET, WATCHDOG_USEC\tAs systemd sets them.",
        "CREDENTIALS_DIRECTORY\tWhere `credential:NAME` in the configuration is looked for.",
        "STATE_DIRECTORY\tWhere saved parameters are kept, unless the configuration says.",
    ],
    "FILES": [
        "/etc/linemate/linemated.yaml\tThe configuration, see linemated.yaml(5).",
        "/var/lib/linemate/parameters.yaml\tParameters that operators saved, an overlay.",
        "/var/lib/linemate/parameters.log\tWho changed which parameter when.",
        "/var/lib/linemate/*.mcap\tRecordings.",
        "/var/log/linemate\tThe last two seconds before missed deadlines and faults.",
    ],
    _SEE: ["linemate(1), linemated.yaml(5), systemd.service(5)"],
}

LINEMATE_SIM: dict[str, list[str]] = {
    "DESCRIPTION": [
        "Emulates the station on the real wires, and runs the daemon against it: in real time as"
        " separate processes, or in virtual time. Needs no hardware and no privileges."
    ],
    "EXIT STATUS": [
        "0\tAssembled within limits; for other commands: done.",
        "1\tNot assembled, or not within limits.",
        "2\tThe command line was wrong.",
        "69\tA port or a device is not available.",
        "78\tA bad file, with every error as file:line:column: key: what.",
    ],
    "EXAMPLES": ["  linemate-sim demo --out out/demo\n  linemate-sim run --seed 0..39"],
    _SEE: ["linemate(1), linemated(8)"],
}


def every() -> Iterator[Page]:
    """Yield each program's parser, its manual section, one line about it, and further sections."""
    yield operator.parser(), 1, "watch and operate a linemate daemon", dict(LINEMATE)
    yield service.parser(), 8, "the daemon that leads a robot at a conveyor", dict(LINEMATED)
    parser: Any = harness._parser()  # noqa: SLF001 - no public name
    yield parser, 1, "emulators of the station, and runs against them", dict(LINEMATE_SIM)
