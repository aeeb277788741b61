"""What the machine must have, and what to do about each thing that it lacks."""

import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys


class SetupError(Exception):
    """Something that a person has to put right; its text says what and how."""


GIB = 1 << 30
# The first pip that takes --platform several times: wheels.py names every glibc that will do.
PIP_NEEDED = (20, 3)


def check_tools(manifest):
    """Cargo and a C++ compiler, needed by every build. All that is wrong is told at once."""
    problems = [problem for problem in (_cargo_problem(manifest), _compiler_problem()) if problem]
    if problems:
        raise SetupError("\n       ".join(problems))


def check_for_install(deps, parts):
    """What only fetching and unpacking needs: pip, room on the disk, a platform with wheels."""
    problems = [_pip_problem(), _disk_problem(deps, parts), _platform_problem(parts)]
    problems = [problem for problem in problems if problem]
    if problems:
        raise SetupError("\n       ".join(problems))


def architecture():
    """The machine's name as wheels spell it."""
    return {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())


def _cargo_problem(manifest):
    needed = re.search(r'^rust-version\s*=\s*"(\d+)\.(\d+)', manifest.read_text(encoding="utf-8"), re.MULTILINE)
    needed = (int(needed[1]), int(needed[2])) if needed else (0, 0)
    wanted = "Rust {}.{} or newer".format(*needed)
    cargo = os.environ.get("CARGO") or "cargo"
    if not shutil.which(cargo):
        return f"cargo was not found: install {wanted} with rustup (https://rustup.rs), then open a new shell"
    answer = _output([cargo, "--version"])
    found = re.search(r"cargo (\d+)\.(\d+)", answer)
    if not found:
        return f"cargo does not run ({_last_line(answer)}): repair it with rustup toolchain install stable"
    if (int(found[1]), int(found[2])) < needed:
        return f"cargo {found[1]}.{found[2]} is too old, {wanted} is needed: run rustup update stable"
    return None


def _compiler_problem():
    compilers = [os.environ["CXX"].split()[0]] if os.environ.get("CXX", "").strip() else ["c++", "g++", "clang++"]
    if any(shutil.which(compiler) for compiler in compilers):
        return None
    return f"no C++ compiler was found (looked for {', '.join(compilers)}): install one, for example with apt-get install g++"


def _pip_problem():
    if not importlib.util.find_spec("pip"):
        return "Python has no pip: install it, for example with apt-get install python3-pip (or python3 -m ensurepip)"
    answer = _output([sys.executable, "-m", "pip", "--version"])
    found = re.search(r"^pip (\d+)\.(\d+)", answer, re.MULTILINE)
    remedy = "run python3 -m pip install --upgrade pip"
    if not found:
        return f"pip does not run ({_last_line(answer)}): {remedy}"
    if (int(found[1]), int(found[2])) < PIP_NEEDED:
        return f"pip {found[1]}.{found[2]} is too old, {PIP_NEEDED[0]}.{PIP_NEEDED[1]} or newer is needed: {remedy}"
    return None


def _disk_problem(deps, parts):
    # What the parts take while they are unpacked, and 3 GiB for the build that follows.
    needed = sum(part.gib for part in parts) + 3.0
    place = deps if deps.exists() else deps.parent
    free = shutil.disk_usage(place).free / GIB
    if free >= needed:
        return None
    return f"{place} has {free:.1f} GiB free and set-up and build need about {needed:.0f} GiB: free some space"


def _platform_problem(parts):
    parts = [part for part in parts if part.needs_platform]
    if not parts:
        return None
    names = " and ".join(part.label for part in parts)
    remedy = f"install {names} yourself and name them with {' and '.join(part.variable for part in parts)}"
    if platform.system() != "Linux" or architecture() not in ("x86_64", "aarch64"):
        return f"{names}: there are no wheels for {platform.system()} on {platform.machine()}: {remedy}"
    library, version = platform.libc_ver()
    if library != "glibc" or tuple(int(number) for number in version.split(".")[:2]) < (2, 28):
        return f"{names}: the wheels need glibc 2.28 or newer and this is {library or 'another C library'} {version}: {remedy}"
    return None


def _output(command):
    try:
        ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, timeout=60)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return ended.stdout.decode("utf-8", "replace")


def _last_line(text):
    lines = text.strip().splitlines()
    return lines[-1] if lines else "no output"
