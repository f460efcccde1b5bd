"""A real systemd as PID 1 of namespaces that are thrown away, with our units and no others.

Nothing of it reaches the machine. Files are an overlay in memory, the network is
a loopback of its own, the cgroups hang below one that is made here and removed here. Where rights
or tools are missing, ``lacking`` says which.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from pathlib import Path
from typing import Self

CHECKOUT = Path(__file__).resolve().parents[1]
SYSTEMD = Path("/lib/systemd/systemd")
TOOLS = ("unshare", "nsenter", "chroot", "mount", "ip", "systemctl", "systemd-sysusers", "make")
NAMESPACES = ("--mount", "--pid", "--uts", "--ipc", "--net", "--cgroup")
BOOT_S = 20.0
PROGRAM = "/opt/linemate"
PYTHON = "/opt/python"
PACKAGES = "/opt/packages"
OUT = "/opt/out"

INTERPRETER = f"{PYTHON}/bin/python{sys.version_info.major}.{sys.version_info.minor}"

TRIED = """
mount -t tmpfs tmpfs . && cd "$PWD"
mkdir upper work root
mount -t overlay overlay -o lowerdir=/,upperdir=upper,workdir=work root
mount -t proc proc root/proc
mount -t sysfs sysfs root/sys
mount -t cgroup2 cgroup2 root/sys/fs/cgroup
mount -t tmpfs tmpfs root/dev
mkdir root/dev/pts
mount -t devpts -o newinstance devpts root/dev/pts
touch root/dev/null
mount --bind /dev/null root/dev/null
ip link set lo up
"""
"""Everything that a boot needs a right for."""

STUBS = ("sysinit.target", "basic.target", "shutdown.target", "network-online.target")
"""Targets that units want by default: empty here, so that nothing of the machine's own runs."""


def lacking() -> str | None:
    """What keeps a systemd from being booted here, None if nothing does."""
    if os.geteuid() != 0:
        return "needs root"
    if not SYSTEMD.exists():
        return f"no {SYSTEMD}"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"no {', '.join(missing)}"
    if "overlay" not in Path("/proc/filesystems").read_text(encoding="ascii"):
        return "the kernel has no overlay file system"
    if _cgroups() is None:
        return "no cgroup2 file system that can be written"
    with tempfile.TemporaryDirectory() as scratch:
        tried = subprocess.run(
            ["unshare", *NAMESPACES, "--fork", "--propagation", "private", "sh", "-ec", TRIED],
            cwd=scratch,
            capture_output=True,
            check=False,
        )
    return None if tried.returncode == 0 else f"no rights: {tried.stderr.decode().strip()}"


def _cgroups() -> Path | None:
    for path in (Path("/sys/fs/cgroup/unified"), Path("/sys/fs/cgroup")):
        if (path / "cgroup.procs").exists() and os.access(path, os.W_OK):
            return path
    return None


class Machine:
    """One booted systemd; the end of the ``with`` block ends it and all that ran in it.

    Attributes:
        scratch: its files on this machine; ``tree`` in it lies over the root.
        out: seen inside as /opt/out, by which results come out.
    """

    def __init__(self, scratch: Path) -> None:
        """Lay out its files."""
        self.scratch = scratch
        self.tree = scratch / "tree"
        self.out = scratch / "out"
        for folder in (self.tree, self.out, scratch / "units", scratch / "memory"):
            folder.mkdir()
        self.out.chmod(0o777)
        self.log = scratch / "systemd.log"
        self._group: Path | None = None
        self._pid: int | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._console: tuple[int, int] | None = None
        self._lay_program()

    def _lay_program(self) -> None:
        """The program as it is installed, by the interpreter and the packages of this test."""
        site = self.tree / PROGRAM[1:] / "lib"
        project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))
        for package, folder in project["tool"]["setuptools"]["package-dir"].items():
            target = site / package.replace(".", "/")
            if folder == ".":
                target.mkdir(parents=True)
                shutil.copy(CHECKOUT / "__init__.py", target)
                continue
            shutil.copytree(CHECKOUT / folder, target)  # with its bytecode, as pip installs it
        bin_ = self.tree / PROGRAM[1:] / "bin"
        bin_.mkdir()
        for name, entry in project["project"]["scripts"].items():
            module, _, function = entry.partition(":")
            text = (
                f"#!{INTERPRETER}\nimport site, sys\n"
                f"sys.path[:0] = [{PROGRAM + '/lib'!r}]\nsite.addsitedir({PACKAGES!r})\n"
                f"from {module} import {function}\nsys.exit({function}())\n"
            )
            (bin_ / name).write_text(text, encoding="utf-8")
            (bin_ / name).chmod(0o755)
        # pip keeps what it compiled next to the sources; the sandbox could not.
        subprocess.run([sys.executable, "-m", "compileall", "-q", str(site)], check=True)
        packages = next(Path(p) for p in sys.path if p.endswith("site-packages"))
        binds = f"{sys.base_prefix} {PYTHON}\n{packages} {PACKAGES}\n{self.out} {OUT}\n"
        (self.scratch / "binds").write_text(binds, encoding="utf-8")

    def unit(self, name: str, text: str) -> None:
        """Add a unit, or ``NAME.d/SOMETHING.conf``."""
        path = self.tree / "etc/systemd/system" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def file(self, name: str, text: str, mode: int = 0o644) -> None:
        """Add a file to the root."""
        path = self.tree / name.lstrip("/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        path.chmod(mode)

    def __enter__(self) -> Self:
        parent = _cgroups()
        assert parent is not None
        self._group = parent / f"linemate-test-{os.getpid()}"
        self._group.mkdir()
        for stub in STUBS:
            (self.scratch / "units" / stub).write_text(
                "[Unit]\nDefaultDependencies=no\n", encoding="utf-8"
            )
        # What is ordered against a unit that is there stays known after its end.
        (self.scratch / "units/test.target").write_text(
            "[Unit]\nDefaultDependencies=no\nAfter=linemated.service\n", encoding="utf-8"
        )
        procs = self._group / "cgroup.procs"
        boot = Path(__file__).with_name("systemd_boot.sh")
        self._console = os.openpty()
        threading.Thread(target=self._read_console, args=(self._console[0],), daemon=True).start()
        # The shell enters the group before the cgroup namespace is made: its root is the group.
        command = (
            f"echo $$ >{procs} && exec unshare {' '.join(NAMESPACES)} --fork --kill-child"
            f" --propagation private sh {boot} {self.scratch}"
            f" {os.ttyname(self._console[1])}"
        )
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                ["sh", "-c", command], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        try:
            self._pid = self._find_first()
            self._await_running()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def log_text(self) -> str:
        """What systemd logged."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def run(
        self, *command: str, timeout_s: float = 60.0, check: bool = True
    ) -> subprocess.CompletedProcess[str]:
        """Run a command inside, as its root."""
        done = subprocess.run(
            [*self._enter(), *command],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        assert not check or done.returncode == 0, (
            command,
            done.stdout,
            done.stderr,
            self.log_text(),
        )
        return done

    def show(self, unit: str, *properties: str) -> dict[str, str]:
        """Properties of a unit."""
        done = self.run("systemctl", "show", unit, *(f"--property={name}" for name in properties))
        return dict(line.split("=", 1) for line in done.stdout.splitlines())

    def _enter(self) -> list[str]:
        assert self._pid is not None
        path = f"PATH={PROGRAM}/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        names = ("--mount", "--uts", "--ipc", "--net", "--pid", "--cgroup", "--root", "--wd")
        return ["nsenter", "--target", str(self._pid), *names, "env", "-i", path]

    def _read_console(self, master: int) -> None:
        """Keep what systemd says; its console goes with the machine."""
        with self.log.open("ab", buffering=0) as log, contextlib.suppress(OSError):
            while data := os.read(master, 4096):
                log.write(data)

    def _find_first(self) -> int:
        """The process that is PID 1 in there."""
        assert self._process is not None
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children")
        end = time.monotonic() + BOOT_S
        while time.monotonic() < end and self._process.poll() is None:
            for pid in children.read_text(encoding="ascii").split():
                with contextlib.suppress(OSError):
                    if Path(f"/proc/{pid}/comm").read_text(encoding="ascii").strip() == "systemd":
                        return int(pid)
            time.sleep(0.02)
        raise AssertionError(f"systemd did not boot: {self.log_text()}")

    def _await_running(self) -> None:
        end = time.monotonic() + BOOT_S
        while time.monotonic() < end:
            done = self.run("systemctl", "is-active", "test.target", check=False)
            if done.stdout.strip() == "active":
                return
            time.sleep(0.05)
        raise AssertionError(f"systemd did not come up: {self.log_text()}")

    def _end(self) -> None:
        if self._process is not None and self._process.poll() is None:
            with contextlib.suppress(Exception):
                self.run("systemctl", "--force", "exit", timeout_s=10.0, check=False)
                self._process.wait(15.0)
            if self._process.poll() is None:
                # PID 1 of a namespace takes all of it along.
                if self._pid is not None:
                    os.kill(self._pid, signal.SIGKILL)
                self._process.kill()
            self._process.wait()
        for side in self._console or ():
            os.close(side)
        self._console = None
        if self._group is not None:
            _remove(self._group)


def _remove(group: Path) -> None:
    """Remove a cgroup and those below it, once their processes have gone."""
    end = time.monotonic() + 10.0
    while group.exists() and time.monotonic() < end:
        for folder in sorted((p for p in group.rglob("*") if p.is_dir()), reverse=True):
            with contextlib.suppress(OSError):
                folder.rmdir()
        with contextlib.suppress(OSError):
            group.rmdir()
        time.sleep(0.02)
