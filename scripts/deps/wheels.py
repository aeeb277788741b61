"""Fetching wheels with pip, checking them, unpacking them, and doing so under one lock."""

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from .machine import SetupError, architecture

# The wheels that we use are made for this Python, or for none, and for a glibc up to 2.28; pip is told so, and it
# does not matter which Python runs the set-up.
PYTHON = "3.12"
GLIBC = (*(f"manylinux_2_{minor}" for minor in range(28, 4, -1)), "manylinux2014", "manylinux2010")
WORK_PREFIX = ".tmp-"


@contextlib.contextmanager
def exclusive(deps):
    """Holds the set-up's lock; what an interrupted run left half done is removed first.

    The lock is the kernel's: it is gone with the process that held it, however that ended.
    """
    deps.mkdir(parents=True, exist_ok=True)
    with open(deps / ".lock", "w", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("set-up: waiting for another set-up of this checkout", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        for leftover in deps.glob(WORK_PREFIX + "*"):
            shutil.rmtree(leftover)
        yield


class Store:
    """Where wheels lie once fetched: CROSS_CACHE, or a folder in .deps that is emptied after use."""

    def __init__(self, folder, keep, work):
        self.folder, self.keep, self.work = Path(folder), keep, Path(work)

    @classmethod
    def for_environment(cls, deps, environment):
        cache = environment.get("CROSS_CACHE", "")
        if cache:
            return cls(Path(cache).expanduser() / "wheels", True, deps)
        return cls(deps / ".wheels", False, deps)

    def fetch(self, requirement, digest):
        """The path of the one wheel that fits `requirement`, fetched unless it is here, checked against `digest`."""
        self.folder.mkdir(parents=True, exist_ok=True)
        name = requirement.replace("-", "_").replace("==", "-")
        for wheel in sorted(self.folder.glob(f"{name}-*.whl")):
            if sha256(wheel) == digest:
                return wheel
            # Of another architecture, or damaged. Only the latter is ours to remove, and which it is cannot
            # be told from here; so it stays in a kept cache and pip's download replaces it if the names agree.
        # Fetched below .deps, where the next run finds and removes what an interrupted one left.
        with tempfile.TemporaryDirectory(prefix=WORK_PREFIX, dir=self.work) as work:
            print(f"set-up: fetching {requirement}", flush=True)
            (wheel,) = pip_download(work, [requirement], with_dependencies=False)
            if sha256(wheel) != digest:
                raise SetupError(
                    f"{wheel.name} is not the file this project was tested with (its SHA-256 differs): "
                    "ask your package mirror's administrator, or check out a newer version of this project"
                )
            return move(wheel, self.folder / wheel.name)

    def done_with(self, wheel):
        """A wheel that has been unpacked takes room for nothing, unless the user asked to keep it."""
        if not self.keep:
            with contextlib.suppress(OSError):
                wheel.unlink()
                self.folder.rmdir()


def pip_download(folder, requirements, with_dependencies):
    """Lets pip put the wheels into `folder`; returns their paths."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-input"]
    # pip's own cache would hold a second copy of all this outside the checkout.
    command += ["--no-cache-dir", "--only-binary=:all:", "--dest", str(folder)]
    command += ["--python-version", PYTHON, "--implementation", "cp", "--abi", "cp312", "--abi", "abi3", "--abi", "none"]
    for glibc in GLIBC:
        command += ["--platform", f"{glibc}_{architecture()}"]
    command += [] if with_dependencies else ["--no-deps"]
    # pip collects a file in TMPDIR first; there, too, an interrupted run shall leave nothing that nobody removes.
    environment = {**os.environ, "TMPDIR": str(folder)}
    ended = subprocess.run(
        command + requirements, env=environment, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    )
    if ended.returncode != 0:
        text = (ended.stderr or ended.stdout).decode("utf-8", "replace").strip()
        why = next((line for line in reversed(text.splitlines()) if line.startswith("ERROR")), text or f"exit code {ended.returncode}")
        raise SetupError(f"pip could not fetch {' '.join(requirements)} ({why}): check the network and pip's settings, then run it again")
    return sorted(Path(folder).glob("*.whl"))


def unpack(wheel, folder, target_of):
    """Unpacks the files of `wheel` for which `target_of(name)` gives a path below `folder`; keeps their mode bits."""
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.infolist():
            relative = None if member.is_dir() else target_of(member.filename)
            if relative is None:
                continue
            target = folder / relative
            if folder.resolve() not in target.resolve().parents:
                raise SetupError(f"{wheel.name} has a file outside its own folder: {member.filename}")
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, open(target, "wb") as sink:
                shutil.copyfileobj(source, sink, 1 << 20)
            mode = stat.S_IMODE(member.external_attr >> 16)
            if mode:
                target.chmod(mode | stat.S_IWUSR)


def move(source, target):
    """Moves a file to where it is complete from the first moment on, also from one file system to another."""
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        beside = target.with_name(f".{target.name}.{os.getpid()}")
        shutil.copyfile(source, beside)
        os.replace(beside, target)
    return target


def sha256(path):
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()
