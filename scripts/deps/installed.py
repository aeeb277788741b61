"""Installations that are there already: a LIBTORCH or SUMO_HOME of the user's own."""

import os
import re
import shlex
import subprocess
from pathlib import Path

from .parts import SUMO_VERSION, TORCH_VERSION

# Variables that lead the Rust bindings past LIBTORCH, to another libtorch or to another way of linking it.
ASTRAY = ("LIBTORCH_USE_PYTORCH", "LIBTORCH_INCLUDE", "LIBTORCH_LIB", "LIBTORCH_CXX11_ABI", "LIBTORCH_STATIC")


class Found:
    """What an environment variable names, and whether it fits."""

    def __init__(self, part, variable, fits=False, label="", remark=""):
        self.part, self.variable, self.fits, self.label, self.remark = part, variable, fits, label, remark


def libtorch(environment, flavour):
    """LIBTORCH fits if it is exactly the version that the Rust bindings are written for."""
    value = environment.get("LIBTORCH", "")
    if not value:
        return Found("libtorch", "LIBTORCH")
    root = Path(value)

    def refuse(why):
        return Found("libtorch", "LIBTORCH", remark=f"LIBTORCH={value} is not used: {why}")

    if not root.is_absolute():
        return refuse("it is not an absolute path")
    if not (root / "lib" / "libtorch_cpu.so").exists() and not (root / "lib" / "libtorch_cpu.dylib").exists():
        return refuse("it has no lib/libtorch_cpu.so")
    if not (root / "include" / "torch" / "csrc" / "api" / "include" / "torch" / "torch.h").exists():
        return refuse("it has no C++ headers (include/torch)")
    version = libtorch_version(root)
    if version != TORCH_VERSION:
        return refuse(f"it is libtorch {version or 'of an unknown version'} and {TORCH_VERSION} is needed")
    if flavour == "cuda" and not (root / "lib" / "libtorch_cuda.so").exists():
        return refuse("CROSS_TORCH=cuda was asked for and it has no lib/libtorch_cuda.so")
    label = f"libtorch {version} from LIBTORCH"
    return Found("libtorch", "LIBTORCH", True, label, f"LIBTORCH={value} is used: libtorch {version}")


def sumo(environment):
    """SUMO_HOME fits if its program sumo starts and is not older than the SUMO that the set-up installs.

    The programs speak one version of TraCI's API (traci/src/constants.rs), which an older SUMO may not know.
    """
    value = environment.get("SUMO_HOME", "")
    if not value:
        return Found("sumo", "SUMO_HOME")
    program = Path(value) / "bin" / "sumo"
    version, why = sumo_version(program)
    if version is not None and release(version) < release(SUMO_VERSION):
        version, why = None, f"it is SUMO {version} and {SUMO_VERSION} or newer is needed"
    if version is None:
        return Found("sumo", "SUMO_HOME", remark=f"SUMO_HOME={value} is not used: {why}")
    label = f"SUMO {version} from SUMO_HOME"
    return Found("sumo", "SUMO_HOME", True, label, f"SUMO_HOME={value} is used: SUMO {version}")


def astray(environment):
    """The variables of ASTRAY that are set."""
    return [variable for variable in ASTRAY if variable in environment]


def release(version):
    """(1, 28, 0) of 1.28.0, so that versions compare; what follows the numbers is left out."""
    numbers = [int(number) for number in re.match(r"[\d.]*", version)[0].split(".") if number]
    return (*numbers, 0, 0, 0)[:3]


def libtorch_version(root):
    """The release number, without a suffix such as +cpu, or None."""
    for name, pattern in (("build-version", r"^\s*([0-9][^\s+]*)"), ("version.py", r"__version__\s*=\s*'([^'+]+)")):
        try:
            found = re.search(pattern, (root / name).read_text(encoding="utf-8"))
        except OSError:
            continue
        if found:
            return found[1]
    try:
        header = (root / "include" / "torch" / "headeronly" / "version.h").read_text(encoding="utf-8")
    except OSError:
        return None
    numbers = [re.search(rf"TORCH_VERSION_{part}\s+(\d+)", header) for part in ("MAJOR", "MINOR", "PATCH")]
    return ".".join(number[1] for number in numbers) if all(numbers) else None


def sumo_version(program):
    """(version, None) if the program starts, else (None, why not)."""
    if not program.exists():
        return None, "it has no bin/sumo"
    try:
        with open(program, "rb") as file:
            if file.read(2) == b"#!":
                # As pip puts one beside Python: SUMO would outlive it when it is killed, so the programs refuse it.
                return None, "bin/sumo is a script that starts SUMO, not SUMO itself"
        ended = subprocess.run(
            [str(program), "--version"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return None, f"bin/sumo does not start: {error}"
    text = ended.stdout.decode("utf-8", "replace").strip()
    found = re.search(r"SUMO sumo (?:Version )?v?(\d\S*)", text)
    if ended.returncode != 0 or not found:
        return None, "bin/sumo does not start: " + (text.splitlines()[-1] if text else f"exit code {ended.returncode}")
    return found[1], None


def write_environment(deps, own):
    """Tells the Makefile which of the user's variables to leave out.

    A LIBTORCH that does not fit would win over .cargo/config.toml, and a SUMO_HOME over .deps. When .deps is
    used the variable is unset rather than set to .deps, so that make and a plain cargo build the same thing.
    The variables of ASTRAY are always left out: the libtorch that is used was checked, what they name was not.
    """
    unset = [*(found.variable for found in own if not found.fits), *ASTRAY]
    text = "# Written by scripts/setup.py; read by the Makefile's recipes.\n"
    text += "".join(f"unset {shlex.quote(variable)}\n" for variable in unset)
    path = deps / "environment.sh"
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        deps.mkdir(parents=True, exist_ok=True)
        fresh = path.with_suffix(f".{os.getpid()}")
        fresh.write_text(text, encoding="utf-8")
        os.replace(fresh, path)
