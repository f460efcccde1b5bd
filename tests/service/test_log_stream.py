"""A log whose reader stands still costs lines, not cycles."""

import fcntl
import os
import select
import subprocess
import sys
from pathlib import Path

from linemate.daemon.service.host.log_stream import LONGEST

LINEMATED = [sys.executable, "-m", "linemate.daemon.service.main"]
WRITE = """
import logging
from linemate.daemon.service.host.log_stream import LogStream
logging.basicConfig(handlers=[LogStream()], format="%(message)s")
for k in range(3000):
    logging.warning("line %d", k)
logging.warning("x" * 9000)
print("wrote", flush=True)
input()
logging.warning("last")
"""


def test_lines_that_nothing_reads_are_dropped_and_counted() -> None:
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 2 * LONGEST)
    with subprocess.Popen(
        [sys.executable, "-c", WRITE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=writing,
        text=True,
    ) as process:
        os.close(writing)
        assert process.stdout is not None
        assert process.stdin is not None
        waits = not select.select([process.stdout], [], [], 20.0)[0]
        if waits:
            process.kill()
        assert not waits
        kept = os.read(reading, 1_000_000).decode().splitlines()
        process.stdin.write("\n")
        process.stdin.close()
        process.wait(20.0)
    rest = os.read(reading, 1_000_000).decode().splitlines()
    os.close(reading)
    assert kept == [f"line {k}" for k in range(len(kept))]
    assert rest == [f"{3001 - len(kept)} lines dropped: the log's reader was too slow", "last"]


def test_a_long_line_keeps_its_end() -> None:
    code = "from linemate.daemon.service.host.log_stream import LogStream; import logging; "
    code += "logging.basicConfig(handlers=[LogStream()]); logging.error('\u00e9' * 9000 + 'end')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert len(done.stderr) < LONGEST
    assert done.stderr.endswith(b"end\n")


def test_a_daemon_whose_starter_has_gone_serves_on(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\nrsi: {port: 0}\ncommand: {socket: null}\n")
    reading, writing = os.pipe()
    os.close(reading)
    with subprocess.Popen(
        [*LINEMATED, "--config", str(path), "--ready-fd", str(writing)],
        pass_fds=[writing],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        os.close(writing)
        assert process.stderr is not None
        lines: list[str] = []
        while not any("ready:" in line for line in lines):
            lines.append(process.stderr.readline())
            assert lines[-1], lines
        process.terminate()
        assert process.wait(20.0) == 0
    assert any("ports are not reported" in line and "Broken pipe" in line for line in lines)


def test_a_log_that_is_closed_is_no_fault() -> None:
    code = "import os; os.close(2); from linemate.daemon.service.host.log_stream import LogStream; "
    code += "import logging; logging.basicConfig(handlers=[LogStream()]); logging.error('x')"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
