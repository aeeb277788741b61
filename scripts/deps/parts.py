"""The three parts of .deps: which wheels each comes from, which of their files, and how it is proved to work."""

import os
import re
import shutil
import subprocess
import sys
import tempfile

from . import wheels
from .machine import SetupError, architecture

TORCH_VERSION = "2.11.0"
SUMO_VERSION = "1.28.0"
MAPS_VERSION = "1.4.5"
STAMP = ".installed"

# SHA-256 of every wheel, by architecture ("any": the same file everywhere).
DIGESTS = {
    "eclipse-sumo==1.28.0": {
        "x86_64": "ec7042794e5ab1d806b90a5983aeda4a978dc4224141b94c0ff3affeeb4ec977",
        "aarch64": "7e94b2da13d20eb4e31b76fcbca9101ec798fb71efee0ca1c0b28ec3e1d0c1a1",
    },
    "torch==2.11.0": {
        "x86_64": "0f68f4ac6d95d12e896c3b7a912b5871619542ec54d3649cf48cc1edd4dd2756",
        "aarch64": "f99924682ef0aa6a4ab3b1b76f40dc6e273fca09f367d15a524266db100a723f",
    },
    # The releases that torch 2.11.0 itself asks for.
    "nvidia-cuda-runtime==13.0.96": {
        "x86_64": "7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548",
        "aarch64": "ef9bcbe90493a2b9d810e43d249adb3d02e98dd30200d86607d8d02687c43f55",
    },
    "nvidia-cuda-cupti==13.0.85": {
        "x86_64": "4eb01c08e859bf924d222250d2e8f8b8ff6d3db4721288cf35d14252a4d933c8",
        "aarch64": "796bd679890ee55fb14a94629b698b6db54bcfd833d391d5e94017dd9d7d3151",
    },
    "sumo-rl==1.4.5": {"any": "322d090e6a66d97cc9b265c0b6fa092687bc6b35965fe5f53f678878d1987660"},
}


def all_parts(flavour):
    """The parts in the order in which they are installed: the quick ones first."""
    return [Maps(), Libtorch(flavour), Sumo()]


class Part:
    """One folder of .deps. Subclasses say what it holds (`fill`) and how to try it (`check`)."""

    name = label = stamp = ""
    variable = ""
    gib = 0.0
    needs_platform = True

    def is_installed(self, deps):
        try:
            return (deps / self.name / STAMP).read_text(encoding="utf-8") == self.stamp
        except OSError:
            return False

    def install(self, deps, store):
        """Fills a folder beside the part's place, tries it, and moves it there. The stamp goes in before the move."""
        work = tempfile.mkdtemp(prefix=f"{wheels.WORK_PREFIX}{self.name}-", dir=deps)
        fresh = deps / work / self.name
        try:
            fresh.mkdir()
            used = self.fill(fresh, store)
            self.check(fresh)
            (fresh / STAMP).write_text(self.stamp, encoding="utf-8")
            place = deps / self.name
            if place.exists():
                os.rename(place, deps / work / "old")
            os.rename(fresh, place)
            for wheel in used:
                store.done_with(wheel)
        finally:
            shutil.rmtree(work, ignore_errors=True)
        print(f"set-up: {self.label} is in {deps.name}/{self.name}", flush=True)

    def fill(self, folder, store):
        """Puts the part's files below `folder`; returns the wheels that it took."""
        raise NotImplementedError

    def check(self, folder):
        """Raises SetupError if what lies in `folder` does not work on this machine."""

    @staticmethod
    def fetch(store, requirement):
        digests = DIGESTS[requirement]
        return store.fetch(requirement, digests.get("any") or digests[architecture()])


class Maps(Part):
    """Nets and demand of the RESCO benchmark: data files alone, no Python."""

    name = "resco"
    label = "RESCO maps"
    stamp = f"RESCO maps of sumo-rl {MAPS_VERSION}, layout 1\n"
    gib = 0.05
    needs_platform = False

    def fill(self, folder, store):
        wheel = self.fetch(store, f"sumo-rl=={MAPS_VERSION}")
        prefix = "sumo_rl/nets/RESCO/"

        def target(name):
            if name.endswith(".dist-info/LICENSE"):
                return "LICENSE"
            return name[len(prefix) :] if name.startswith(prefix) else None

        wheels.unpack(wheel, folder, target)
        return [wheel]

    def check(self, folder):
        for name in ("grid4x4", "arterial4x4"):
            if not (folder / name / f"{name}.net.xml").exists():
                raise SetupError(f"the wheel sumo-rl {MAPS_VERSION} has no net {name}: report this with the wheel's source")


class Sumo(Part):
    """SUMO as its wheel lays it out: sumo/ (this is SUMO_HOME) and the libraries it was linked with beside it."""

    name = "sumo"
    label = f"SUMO {SUMO_VERSION}"
    stamp = f"eclipse-sumo {SUMO_VERSION} {architecture()}, layout 1\n"
    variable = "SUMO_HOME"
    gib = 0.7

    def fill(self, folder, store):
        wheel = self.fetch(store, f"eclipse-sumo=={SUMO_VERSION}")
        wheels.unpack(wheel, folder, lambda name: name if re.match(r"(sumo|eclipse_sumo\.libs)/", name) else None)
        return [wheel]

    def check(self, folder):
        from .installed import sumo_version

        version, why = sumo_version(folder / "sumo" / "bin" / "sumo")
        if version is None:
            raise SetupError(f"SUMO {SUMO_VERSION} was unpacked, but {why}: install what it names, then run it again")


class Libtorch(Part):
    """libtorch as torch's wheel lays it out: torch/ (this is LIBTORCH) and nvidia/, where its own rpath looks."""

    name = "libtorch"
    variable = "LIBTORCH"
    # Python's side of torch, and what its CPU library never loads.
    PYTHON_LIBRARIES = r"libtorch_python\.so|libshm"
    CUDA_LIBRARIES = r"libtorch_cuda|libc10_cuda|libtorch_nvshmem|libcaffe2_nvrtc"
    # The two CUDA libraries that libtorch_cpu.so is linked with, also where no GPU is.
    CPU_NEEDS = r"nvidia/cu13/lib/lib(cudart|cupti)\.so"

    def __init__(self, flavour):
        self.flavour = flavour
        self.label = f"libtorch {TORCH_VERSION}" + (" with CUDA" if flavour == "cuda" else "")
        self.stamp = f"torch {TORCH_VERSION} {flavour} {architecture()}, layout 1\n"
        self.gib = 8.0 if flavour == "cuda" else 1.5

    def fill(self, folder, store):
        torch = self.fetch(store, f"torch=={TORCH_VERSION}")
        used = [torch]
        wheels.unpack(torch, folder, self.torch_file)
        if self.flavour == "cuda":
            self.fill_cuda(folder, torch)
        else:
            for requirement in ("nvidia-cuda-runtime==13.0.96", "nvidia-cuda-cupti==13.0.85"):
                wheel = self.fetch(store, requirement)
                used.append(wheel)
                wheels.unpack(wheel, folder, lambda name: name if re.match(self.CPU_NEEDS, name) else None)
            # The wheel's libtorch.so holds no code; it only names libtorch_cpu.so and libtorch_cuda.so, the second
            # of which is not here. A linker script in its place leaves -ltorch meaning the first.
            (folder / "torch" / "lib" / "libtorch.so").write_text("INPUT ( AS_NEEDED ( -ltorch_cpu ) )\n", encoding="utf-8")
        (folder / "torch" / "build-version").write_text(TORCH_VERSION + "\n", encoding="utf-8")
        return used

    def torch_file(self, name):
        """Headers and libraries; of the libraries those that this flavour has."""
        if not re.match(r"torch/(lib|include)/", name) or re.match(rf"torch/lib/({self.PYTHON_LIBRARIES})", name):
            return None
        if self.flavour == "cpu" and re.match(rf"torch/lib/({self.CUDA_LIBRARIES})", name):
            return None
        return name

    def fill_cuda(self, folder, torch):
        """Adds every CUDA library that torch depends on; pip works out which those are."""
        with tempfile.TemporaryDirectory(prefix=wheels.WORK_PREFIX, dir=folder.parent) as work:
            print("set-up: fetching torch's CUDA libraries (about 2 GB)", flush=True)
            for wheel in wheels.pip_download(work, [str(torch)], with_dependencies=True):
                wheels.unpack(wheel, folder, lambda name: name if re.match(r"nvidia/[^/]+/lib/.*\.so", name) else None)

    def check(self, folder):
        library = folder / "torch" / "lib" / ("libtorch_cuda.so" if self.flavour == "cuda" else "libtorch_cpu.so")
        ended = subprocess.run(
            [sys.executable, "-c", "import ctypes, sys; ctypes.CDLL(sys.argv[1])", str(library)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )
        if ended.returncode != 0:
            why = ended.stdout.decode("utf-8", "replace").strip().splitlines()
            raise SetupError(f"{library.name} was unpacked, but does not load ({why[-1] if why else 'no reason given'}): install what it names, then run it again")
